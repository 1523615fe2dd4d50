"""Define the model: lobes, parameters over theta_diff, values, albedo and sampling."""

from dsbrdf.model.albedo import directional_albedo as directional_albedo
from dsbrdf.model.dsbrdf import DSBRDF as DSBRDF
from dsbrdf.model.lobes import FAMILIES as FAMILIES
from dsbrdf.model.lobes import MAX_CENTER as MAX_CENTER
from dsbrdf.model.lobes import gamma_of_half_width as gamma_of_half_width
from dsbrdf.model.lobes import half_width as half_width
from dsbrdf.model.reflectance import Blend as Blend
from dsbrdf.model.reflectance import FurnaceReport as FurnaceReport
from dsbrdf.model.reflectance import ReflectanceModel as ReflectanceModel
from dsbrdf.model.reflectance import blend as blend
from dsbrdf.model.reflectance import white_furnace as white_furnace
