"""Represent measured reflectance: the angles, the grid, file formats, interpolation and the reduction to profiles."""

from dsbrdf.data.geometry import (
    CHANNELS,
    DEFAULT_HORIZON_CUTOFF,
    GRID_SHAPE,
    PHI_DIFF,
    THETA_DIFF,
    THETA_HALF,
    above_horizon,
    directions,
    half_difference,
    incident_cosines,
    nodes_above_horizon,
    spherical,
)
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import encode_merl, parse_merl, read_merl, write_merl
from dsbrdf.data.merl_validation import FILE_SIZE
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.data.rgl import parse_rgl, read_rgl
from dsbrdf.data.synthetic import model_measurement, synthetic_measurement

__all__ = [
    "CHANNELS",
    "DEFAULT_HORIZON_CUTOFF",
    "FILE_SIZE",
    "GRID_SHAPE",
    "PHI_DIFF",
    "THETA_DIFF",
    "THETA_HALF",
    "Measurement",
    "Profiles",
    "above_horizon",
    "directions",
    "encode_merl",
    "half_difference",
    "incident_cosines",
    "model_measurement",
    "nodes_above_horizon",
    "parse_merl",
    "parse_rgl",
    "profiles",
    "read_merl",
    "read_rgl",
    "spherical",
    "synthetic_measurement",
    "write_merl",
]
