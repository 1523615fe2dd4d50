"""Convert a model's parameters to cubic polynomials in Bernstein's form, for programs in single precision.

In Bernstein's form, a polynomial is a mean of its four coefficients with nonnegative weights, so that no digits cancel.
"""

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.splines import pieces_of

_MAX_SINGLE = 3e38  # A larger number overflows single precision.


def literal(value: float) -> str:
    """Return a number as a literal of GLSL in single precision."""
    text = str(np.float32(value)) if abs(value) > 1e-37 else "0.0"
    return text if "." in text or "e" in text else text + ".0"


def constant_array(kind: str, name: str, values: Array) -> str:
    """Return a constant array of numbers or vectors (n, k) in GLSL."""
    items = (f"{kind}({', '.join(map(literal, row))})" for row in values.tolist())
    return f"const {kind} {name}[{len(values)}] = {kind}[{len(values)}](\n  " + ",\n  ".join(items) + ");\n"


def constant(name: str, value: float) -> str:
    """Return a constant number in GLSL."""
    return f"const float dsbrdf_{name} = {literal(value)};\n"


def bernstein_pieces(model: DSBRDF, program: str) -> tuple[Array, Array]:
    """Return the breaks in theta_diff between polynomial pieces, and Bernstein coefficients (row, piece, 4).

    The rows are the parameters in `dsbrdf.DSBRDF.pieces`, followed by the three channels of the paper's delta term.
    Raises InvalidArgumentError if a parameter is too large for the single precision of a program.
    """
    breaks, terms = model.pieces
    rows = np.concatenate([terms, _delta_terms(model, breaks)], axis=1)
    largest = max(model.amplitude.max(initial=0.0), model.gamma.max(initial=0.0), np.abs(rows).max(initial=0.0))
    if largest > _MAX_SINGLE:
        raise InvalidArgumentError(f"a parameter of the model is too large for {program}, which has single precision")
    return breaks, _bernstein(rows, np.diff(breaks))


def bernstein_bases(model: DSBRDF) -> dict[str, Array]:
    """Return, for each name of a parameter, the Bernstein coefficients (angle, piece, 4) of a basis.

    A function of the basis is the interpolation of control values that are 1 at one angle and 0 at all others. The
    coefficients of a parameter are the sum of its control values times the coefficients of the basis.
    """
    breaks, _ = model.pieces
    knots = dict.fromkeys(("kappa", "gamma", "center"), model.shape_theta_diff)
    knots |= {"amplitude": model.theta_diff, "elongation": model.elongation_theta_diff}
    bases = {}
    for name in ("amplitude", "kappa", "gamma", "center", "elongation"):
        controls = np.eye(getattr(model, name).shape[-2])
        # The result has the axes (power, piece, angle of the control value).
        terms = pieces_of(knots[name], controls, breaks, spline=model.interpolation == "spline")
        bases[name] = _bernstein(terms.transpose(0, 2, 1), np.diff(breaks))
    return bases


def _bernstein(terms: Array, width: Array) -> Array:
    """Return Bernstein coefficients (row, piece, 4) of cubic polynomials (4, row, piece), cubic coefficient first."""
    cubic, square, slope, level = (term * width**power for term, power in zip(terms, (3, 2, 1, 0), strict=True))
    first, second = level + slope / 3.0, level + (2.0 * slope + square) / 3.0
    return np.stack([level, first, second, level + slope + square + cubic], axis=-1)


def _delta_terms(model: DSBRDF, breaks: Array) -> Array:
    """Return the delta term of the paper's model as cubic polynomials, axes (power, channel, piece)."""
    at = np.stack([np.interp(breaks, model.theta_diff, row) for row in model.delta])
    slope = np.diff(at, axis=1) / np.diff(breaks)
    return np.stack([np.zeros_like(slope), np.zeros_like(slope), slope, at[:, :-1]])
