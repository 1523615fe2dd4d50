"""The model: the lobe, its parameters over theta_diff, values, albedo and lit spheres."""
