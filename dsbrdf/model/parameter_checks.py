"""What the parameters of a `DSBRDF` must fulfil: shapes that agree, and numbers that its formula can work with."""

from collections.abc import Mapping

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.lobe_families import FAMILIES, LARGEST_CENTER
from dsbrdf.model.splines import n_control_values

INTERPOLATIONS = ("linear", "spline")
"""How parameters run between knots, see `DSBRDF`."""
_LARGEST = {"amplitude": 1e300, "kappa": 700.0, "gamma": 1e100, "delta": 1e300}
_LARGEST_ELONGATION = 10.0


def check_parameters(arrays: Mapping[str, Array], interpolation: str, lobe: str) -> None:
    """Check all attributes of a model: the arrays by their names, and the names of interpolation and lobe.

    Raises InvalidArgumentError if shapes disagree, a number is not finite or a parameter is out of range.
    """
    if interpolation not in INTERPOLATIONS:
        raise InvalidArgumentError(f"interpolation must be one of {', '.join(INTERPOLATIONS)}, not {interpolation!r}")
    if lobe not in FAMILIES:
        raise InvalidArgumentError(f"lobe must be one of {', '.join(FAMILIES)}, not {lobe!r}")
    for name in ("theta_diff", "shape_theta_diff", "elongation_theta_diff"):
        _check_knots(name, arrays[name])
    amplitude, kappa = arrays["amplitude"], arrays["kappa"]
    if amplitude.ndim != 3 or kappa.ndim != 3:
        raise InvalidArgumentError("amplitude and kappa must have three axes: channel, control value and lobe")
    count = n_control_values if interpolation == "spline" else int
    lobes, n_shapes = amplitude.shape[2], 1 if kappa.shape[0] == 1 else 3
    shapes = {
        "amplitude": (3, count(arrays["theta_diff"].size), lobes),
        **dict.fromkeys(("kappa", "gamma", "center"), (n_shapes, count(arrays["shape_theta_diff"].size), lobes)),
        "elongation": (count(arrays["elongation_theta_diff"].size), lobes),
        "delta": (3, arrays["theta_diff"].size),
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise InvalidArgumentError(f"{name} must have shape {shape}, not {arrays[name].shape}")
        if not np.isfinite(arrays[name]).all():
            raise InvalidArgumentError(f"every {name} must be finite")
    _check_ranges(arrays, spline=interpolation == "spline")


def _check_knots(name: str, knots: Array) -> None:
    if knots.ndim != 1 or knots.size == 0:
        raise InvalidArgumentError(f"{name} must be a sequence of at least one knot")
    if not (knots[0] >= 0 and knots[-1] <= np.pi / 2 + 1e-9 and np.all(np.diff(knots) > 0)):
        raise InvalidArgumentError(f"the knots {name} must increase from 0 or more to at most pi/2")


def _check_ranges(arrays: Mapping[str, Array], *, spline: bool) -> None:
    if not np.all(arrays["kappa"] > 0):
        raise InvalidArgumentError("every kappa must be positive")
    for name in ("amplitude", "gamma", "delta"):
        if spline and name != "delta" and not np.all(arrays[name] > 0):
            raise InvalidArgumentError(f"every {name} must be positive for a spline, which is one of its logarithm")
        if not np.all(arrays[name] >= 0):
            raise InvalidArgumentError(f"every {name} must be zero or positive")
    for name, largest in _LARGEST.items():
        if arrays[name].max(initial=0.0) > largest:
            raise InvalidArgumentError(f"no {name} may exceed {largest:g}: values would leave the range of numbers")
    if np.abs(arrays["center"]).max(initial=0.0) > LARGEST_CENTER:
        raise InvalidArgumentError(f"every center must lie between -{LARGEST_CENTER:g} and {LARGEST_CENTER:g} radians")
    if np.abs(arrays["elongation"]).max(initial=0.0) > _LARGEST_ELONGATION:
        raise InvalidArgumentError(f"every elongation must lie between -{_LARGEST_ELONGATION:g} and its opposite")
