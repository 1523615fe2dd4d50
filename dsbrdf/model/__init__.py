"""Define the model: lobes, parameters over theta_diff, values, albedo and sampling."""

from dsbrdf.model.albedo import directional_albedo
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import FAMILIES, MAX_CENTER, gamma_of_half_width, half_width
from dsbrdf.model.reflectance import Blend, FurnaceReport, ReflectanceModel, blend, white_furnace

__all__ = [
    "DSBRDF",
    "FAMILIES",
    "MAX_CENTER",
    "Blend",
    "FurnaceReport",
    "ReflectanceModel",
    "blend",
    "directional_albedo",
    "gamma_of_half_width",
    "half_width",
    "white_furnace",
]
