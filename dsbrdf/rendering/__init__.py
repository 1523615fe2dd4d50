"""Lit spheres, environments, and how far two images are apart."""
