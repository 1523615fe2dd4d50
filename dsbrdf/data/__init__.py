"""Represent measured reflectance: the angles, the grid, file formats, interpolation and the reduction to profiles."""

from dsbrdf.data.geometry import CHANNELS as CHANNELS
from dsbrdf.data.geometry import DEFAULT_HORIZON_CUTOFF as DEFAULT_HORIZON_CUTOFF
from dsbrdf.data.geometry import GRID_SHAPE as GRID_SHAPE
from dsbrdf.data.geometry import PHI_DIFF as PHI_DIFF
from dsbrdf.data.geometry import THETA_DIFF as THETA_DIFF
from dsbrdf.data.geometry import THETA_HALF as THETA_HALF
from dsbrdf.data.geometry import above_horizon as above_horizon
from dsbrdf.data.geometry import directions as directions
from dsbrdf.data.geometry import half_difference as half_difference
from dsbrdf.data.geometry import incident_cosines as incident_cosines
from dsbrdf.data.geometry import nodes_above_horizon as nodes_above_horizon
from dsbrdf.data.geometry import spherical as spherical
from dsbrdf.data.measurement import Measurement as Measurement
from dsbrdf.data.merl import encode_merl as encode_merl
from dsbrdf.data.merl import parse_merl as parse_merl
from dsbrdf.data.merl import read_merl as read_merl
from dsbrdf.data.merl import write_merl as write_merl
from dsbrdf.data.merl_validation import FILE_SIZE as FILE_SIZE
from dsbrdf.data.reduction import Profiles as Profiles
from dsbrdf.data.reduction import profiles as profiles
from dsbrdf.data.rgl import parse_rgl as parse_rgl
from dsbrdf.data.rgl import read_rgl as read_rgl
from dsbrdf.data.synthetic import model_measurement as model_measurement
from dsbrdf.data.synthetic import synthetic_measurement as synthetic_measurement
