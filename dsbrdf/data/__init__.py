"""Measured reflectance: the angles, the grid, the file format and the exact reduction to profiles."""
