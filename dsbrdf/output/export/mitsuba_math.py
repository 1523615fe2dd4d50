"""Functions on the numbers of the variant of Mitsuba that is set: floats of Python, or arrays of drjit.

What single precision would lose is kept: ``expm1`` and ``log1p``, which drjit does not have, are series near 0.
Derivatives stay finite: also the branch that is not taken must not have an infinite one, for zero times it is not zero.
"""

from importlib import import_module
from typing import Any

import numpy as np

from dsbrdf.model.lobe_families import FAMILIES, SeriesMath

Number = Any
"""A float or int of Python, or an array of drjit."""


class Table:
    """Numbers of any shape that are looked up by their index in the flat array."""

    def __init__(self, values: Any) -> None:
        self._drjit, self._float = import_module("drjit"), import_module("mitsuba").Float
        if self._drjit.is_array_v(values):
            self._values = values
        else:
            flat = np.ravel(np.asarray(values, dtype=np.float32))
            self._values = flat.tolist() if self._float is float else self._float(flat)

    def __getitem__(self, index: Number) -> Number:
        return self._values[index] if self._float is float else self._drjit.gather(self._float, self._values, index)


def log1p(x: Number) -> Number:
    """Logarithm of 1 + x, x zero or positive."""
    dr = import_module("drjit")
    s = x / (2.0 + x)
    t = s * s
    series = 2.0 * s * (1.0 + t * (1.0 / 3.0 + t * (0.2 + t * (1.0 / 7.0 + t * (1.0 / 9.0)))))
    return dr.select(x < 0.5, series, dr.log(1.0 + x))


def expm1(x: Number) -> Number:
    """Exponential of x less 1."""
    dr = import_module("drjit")
    y = dr.clip(x, -0.3, 0.3)
    series = y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y * (1.0 / 720.0))))))
    return dr.select(dr.abs(x) < 0.3, series, dr.exp(dr.clip(x, -80.0, 88.0)) - 1.0)


def safe_root(x: Number) -> Number:
    """Square root of x, zero or positive, with a derivative that is 0 at 0."""
    dr = import_module("drjit")
    positive = x > 0.0
    return dr.select(positive, dr.sqrt(dr.select(positive, x, 1.0)), 0.0)


def lobe_value(squared: Number, kappa: Number, gamma: Number, center: Number | None, family: str) -> Number:
    """Value of a lobe of height 1; see `dsbrdf.model.lobes.lobe_values`."""
    dr = import_module("drjit")
    top_squared: Number = 0.0
    if center is not None:
        root, tan_center = safe_root(squared), dr.tan(center)
        tangent = dr.clip((root - tan_center) / (1.0 + root * dr.maximum(tan_center, 0.0)), -1e12, 1e12)
        squared, top_squared = tangent * tangent, dr.minimum(tan_center, 0.0) ** 2
    return FAMILIES[family].value_of_squares(SeriesMath(dr.exp, expm1, log1p), squared, top_squared, kappa, gamma)
