"""Measured reflectance: the angles, the grid, the file format and the exact reduction to profiles."""

from dsbrdf.data.grid import CHANNELS, GRID_SHAPE, PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import encode_merl, parse_merl, read_merl, write_merl
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.data.synthetic import synthetic_measurement

__all__ = [
    "CHANNELS",
    "GRID_SHAPE",
    "PHI_DIFF",
    "THETA_DIFF",
    "THETA_HALF",
    "Measurement",
    "Profiles",
    "encode_merl",
    "parse_merl",
    "profiles",
    "read_merl",
    "synthetic_measurement",
    "write_merl",
]
