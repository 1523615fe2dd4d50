"""The model: the lobe, its parameters over theta_diff, values, albedo and lit spheres."""

from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import ReflectanceModel

__all__ = ["DSBRDF", "ReflectanceModel"]
