"""Directional Statistics BRDF models of measured reflectance (Nishino, ICCV 2009).

    measurement = dsbrdf.read_merl("nickel.binary")
    result = dsbrdf.fit(measurement)
    result.model.evaluate(theta_half, theta_diff)
    dsbrdf.decompose(result.model).diffuse

Angles are in radians, BRDF values in 1/sr, channels in the order red, green, blue.
"""

from importlib.metadata import version

__version__ = version("dsbrdf")

from dsbrdf.decomposition import Component, Decomposition, decompose
from dsbrdf.errors import (
    ConvergenceWarning,
    DSBRDFError,
    FitError,
    InvalidArgumentError,
    MeasurementFormatError,
    ModelFormatError,
)
from dsbrdf.fit import ALGORITHM_VERSION, FitOptions, FitReport, FitResult, fit
from dsbrdf.measurement import Measurement
from dsbrdf.merl import parse_merl, read_merl, write_merl
from dsbrdf.model import DSBRDF
from dsbrdf.profiles import Profiles, profiles
from dsbrdf.serialize import load, save

__all__ = [
    "ALGORITHM_VERSION",
    "DSBRDF",
    "Component",
    "ConvergenceWarning",
    "DSBRDFError",
    "Decomposition",
    "FitError",
    "FitOptions",
    "FitReport",
    "FitResult",
    "InvalidArgumentError",
    "Measurement",
    "MeasurementFormatError",
    "ModelFormatError",
    "Profiles",
    "decompose",
    "fit",
    "load",
    "parse_merl",
    "profiles",
    "read_merl",
    "save",
    "write_merl",
]
