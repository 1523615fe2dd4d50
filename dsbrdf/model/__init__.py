"""Define the model: lobes, parameters over theta_diff, values, albedo and sampling."""

from dsbrdf.model.albedo import directional_albedo
from dsbrdf.model.blend import Blend, blend
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.furnace import FurnaceReport, white_furnace
from dsbrdf.model.lobe_families import FAMILIES, MAX_CENTER
from dsbrdf.model.lobes import gamma_of_half_width, half_width
from dsbrdf.model.reflectance import ReflectanceModel

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
