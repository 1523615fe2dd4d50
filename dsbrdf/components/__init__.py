"""The three parts of a reflectance: physical layers, their fit, and the decomposition into components."""
