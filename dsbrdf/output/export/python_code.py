"""Define the functions of an exported Python file; `dsbrdf.output.export.python_file` copies their source.

The functions use the common interface `xp` of NumPy, PyTorch and JAX. Derivatives are finite wherever values are
finite, because arguments of roots and denominators are kept above 0. Parameters and formulas are as in
`dsbrdf.model.dsbrdf`, `dsbrdf.components.layers` and `dsbrdf.components.shares`. An exported file has at most 150
lines.
"""

import itertools
import math
import sys
from typing import Any

import numpy

from dsbrdf.components.layer_data import COAT_F0, MAX_TAN2, MIN_COSINE, MIN_RISE, MIN_SINE
from dsbrdf.components.shares import EXCESS_HALO, HALO, SPIKE_HALO
from dsbrdf.data.geometry import CENTER_CUTOFF
from dsbrdf.model.lobes import GRAZING_COSINE


def _arrays(parameters: dict[str, Any], *directions: Any) -> tuple[Any, Any, Any, dict[str, Any]]:
    """Return the directions' array library, the directions, and the parameters as arrays in the same precision."""
    values, torch = (*directions, *parameters.values()), sys.modules.get("torch")
    spaces = [value.__array_namespace__() for value in values if hasattr(value, "__array_namespace__")]
    xp: Any = next((space for space in spaces if space.__name__ != "numpy"), numpy)
    xp = torch if torch and any(isinstance(value, torch.Tensor) for value in values) else xp
    plain = (list, tuple, float, int, numpy.ndarray, numpy.generic)
    first, second = (1.0 * (xp.asarray(value) if isinstance(value, plain) else value) for value in directions)
    like = {"dtype": first.dtype} | ({"device": first.device} if xp is torch else {})
    return xp, first, second, {k: xp.asarray(v, **like) if isinstance(v, plain) else v for k, v in parameters.items()}


def _angles(xp: Any, first: Any, second: Any) -> tuple[Any, Any, Any, Any]:
    """Return for pairs of directions: whether both are above the horizon, and the angles that the model needs."""
    total, difference = first + second, first - second
    sum2, difference2, radius2 = (xp.clip((v * v).sum(-1), 1e-30, None) for v in (total, difference, total[..., :2]))
    (x, y, z), (dx, dy, dz) = ([v[..., i] for i in range(3)] for v in (total, difference))
    along2, across2 = (z * (x * dx + y * dy) - radius2 * dz) ** 2 + 1e-30, sum2 * (x * dy - y * dx) ** 2
    above, tan_diff = (first[..., 2] >= -1e-12) & (second[..., 2] >= -1e-12), xp.sqrt(difference2 / sum2)
    return above[..., None], xp.arctan(tan_diff), radius2 / xp.clip(z * z, 1e-18, None), along2 / (along2 + across2)


def _spline(xp: Any, knots: list[float], values: Any, at: Any, degree: int) -> Any:
    """Return B-splines (..., channel, lobe) of control values (channel, index, lobe) at angles (...)."""
    if len(knots) == 1:
        return values[:, 0, :]
    at, ends = xp.clip(at, knots[0], knots[-1]), [knots[0]] * degree + knots + [knots[-1]] * degree
    pieces = [((at >= a) & ((at < b) | (b == knots[-1])) & (a < b)) for a, b in itertools.pairwise(ends)]
    weights = [xp.where(is_inside, xp.ones_like(at), xp.zeros_like(at)) for is_inside in pieces]
    for n in range(1, degree + 1):
        rise = [(at - low) / (high - low or 1.0) for low, high in zip(ends, ends[n:], strict=False)]
        weights = [rise[i] * w + (1.0 - rise[i + 1]) * weights[i + 1] for i, w in enumerate(weights[:-1])]
    base = values[:, 0, :] * (degree - 1) / 2.0  # Sums of differences from base lose fewer digits than sums of values.
    return base + sum(w[..., None, None] * (values[:, i, :] - base) for i, w in enumerate(weights))


def _model(xp: Any, theta_diff: Any, tan2: Any, cos2_phi: Any, p: dict[str, Any]) -> Any:
    """Return the RGB values (..., 3) of the model: the sum of the lobes and the delta term of the paper."""
    degree, log, exp = (3, xp.log, xp.exp) if IS_SPLINE else (1, xp.positive, xp.positive)
    kappa, gamma = (exp(_spline(xp, KNOTS[1], log(p[name]), theta_diff, degree)) for name in ("kappa", "gamma"))
    tangent = xp.tan(_spline(xp, KNOTS[1], p["center"], theta_diff, degree))
    log, exp = (xp.log, xp.exp) if IS_SPLINE else (xp.log1p, xp.expm1)
    amplitude = exp(_spline(xp, KNOTS[0], log(p["amplitude"]), theta_diff, degree))
    cosine4 = GRAZING_COSINE**4 + (1.0 - GRAZING_COSINE**4) * xp.cos(theta_diff) ** 4
    log_cosine, tan2, cos2 = (one[..., None, None] for one in (xp.log(cosine4) / 4.0, tan2, cos2_phi))
    ratio = xp.exp(_spline(xp, KNOTS[2], p["elongation"][None], theta_diff, degree) * log_cosine)
    root = xp.sqrt(xp.clip(tan2 * (cos2 / ratio + (1.0 - cos2) * ratio), 1e-30, None))
    offset = (root - tangent) / (1.0 + root * xp.clip(tangent, 0.0, None))
    square = xp.where(tangent == 0.0, offset, xp.clip(offset, None, MAX_TANGENT)) ** 2
    value = _lobe(xp, kappa, gamma, square, xp.clip(tangent, None, 0.0) ** 2)
    result, near = (amplitude * value).sum(-1), tan2[..., 0] < math.tan(CENTER_CUTOFF) ** 2
    return result + near * _spline(xp, KNOTS[0], p["delta"], theta_diff, 1)[..., 0] if "delta" in p else result


def _hemi_epd(xp: Any, kappa: Any, gamma: Any, square: Any, top2: Any) -> Any:
    """Return a lobe of the paper's distribution at the squared tangent `square`; its maximum, 1, is at `top2`."""
    low = max(-200.0, math.log(xp.finfo(square.dtype).tiny) + 7.0)  # exp(low) is small, but does not underflow.
    fall = xp.clip(gamma / 2.0 * (xp.log1p(top2) - xp.log1p(square)), low, None)
    top = kappa * xp.exp(xp.clip(-gamma / 2.0 * xp.log1p(top2), low, None))
    return xp.exp(top * xp.expm1(fall)) * xp.expm1(-top * xp.exp(fall)) / xp.expm1(-top)


def _student(xp: Any, kappa: Any, gamma: Any, square: Any, top2: Any) -> Any:
    """Return a lobe of Student's distribution at the squared tangent `square`; its maximum, 1, is at `top2`."""
    low = max(-200.0, math.log(xp.finfo(square.dtype).tiny) + 7.0)  # exp(low) is small, but does not underflow.
    return xp.exp(xp.clip(kappa * (xp.log1p(gamma * top2) - xp.log1p(gamma * square)), low, None))


def _rise(xp: Any, cosine: Any) -> Any:
    """Return the reflectance of glass, scaled to 0 at normal incidence and to 1 at grazing incidence."""
    bent = xp.sqrt(1.25 + cosine**2)
    square = ((cosine * (bent + cosine) - 1.0) / (cosine * (bent - cosine) + 1.0)) ** 2
    return xp.clip(0.5 * ((bent - cosine) / (bent + cosine)) ** 2 * (1.0 + square) - COAT_F0, 0.0, None) / (1 - COAT_F0)


def _facets(xp: Any, cos_in: Any, cos_out: Any, tan2: Any, alpha: Any, tail: Any, masking: Any) -> Any:
    """Return the logarithm of a rough surface's distribution of facets times masking; the tail exponent 2 is GGX."""
    square, norm = alpha**2, 0.125 + xp.logaddexp(8.0 * (tail - 1.125), 0.0 * tail) / 8.0
    to_in, to_out = (xp.sqrt(square + (1.0 - square) * cosine**2) for cosine in (cos_in, cos_out))
    seen, both = cos_out * to_in + cos_in * to_out, (cos_in + to_in) * (cos_out + to_out)
    tails = 2.0 * xp.log1p(tan2) - tail * xp.log1p(tan2 / (norm * square))
    return tails + masking * xp.log(2.0 * seen / both) - xp.log(2.0 * math.pi * square * seen)


def _layers(xp: Any, pair: tuple[Any, Any], theta_diff: Any, tan2: Any, parameters: dict[str, Any], names: Any) -> Any:
    """Return the logarithm of the sum of the layers with the given names (..., 3)."""
    cos_in, cos_out = (xp.clip(omega[..., 2], MIN_COSINE, 1.0) for omega in pair)
    u, sin2, tan2 = 2.0 * xp.sin(theta_diff / 2.0) ** 2, xp.sin(theta_diff) ** 2, xp.clip(tan2, None, MAX_TAN2)
    to_in, to_out, fresnel = (_rise(xp, cosine) for cosine in (cos_in, cos_out, 1.0 - u))
    passed, sin2_half, rise = xp.log((1.0 - to_in) * (1.0 - to_out)), tan2 / (1.0 + tan2), fresnel[..., None]
    total = 0.0 * rise - 1e4  # The logarithm -1e4 stands for a sum without layers, because exp(-1e4) is 0.
    for name in names:
        p = {key.rpartition(".")[2]: value for key, value in parameters.items() if key.rpartition(".")[0] == name}
        if "f0" in p:  # Only specular layers have F0.
            bent = p["rise"][0] * u + p["rise"][1] * u**2 + p["under_coat"] * (passed + 2.0 * math.log1p(-COAT_F0))
            color = xp.log(p["f0"] * (1.0 - rise) + p["f90"] * rise)
            form = bent + _facets(xp, cos_in, cos_out, tan2, p["alpha"], p["tail_exponent"], p["masking"])
        elif "alpha" in p:  # Of the other layers, only retro layers have a roughness alpha.
            back2 = xp.clip(4.0 * sin2 - (cos_in - cos_out) ** 2, 0.0, None) / (cos_in + cos_out) ** 2
            color, form = xp.log(p["color"]), _facets(xp, cos_in, cos_out, back2, p["alpha"], 0.0 * u + 2.0, 0.0)
        elif "powers" in p:  # Only sheen layers have powers.
            log_u, log_sin2 = xp.log(xp.clip(u, MIN_RISE, None)), xp.log(xp.clip(sin2_half, MIN_SINE**2, None))
            color, form = xp.log(p["color"]), p["powers"][0] * log_u + p["powers"][1] / 2.0 * log_sin2
        else:
            along, limb = 1.0 - 2.0 * sin2 - cos_in * cos_out, xp.log(2.0 / (cos_in + cos_out))
            along = xp.where(along > 0.0, along / xp.maximum(cos_in, cos_out), along)
            ground = passed, (1.0 - sin2) * (to_in + to_out), fresnel, limb, sin2_half, along
            color, form = xp.log(p["albedo"] / math.pi), sum(p["exponents"][i] * one for i, one in enumerate(ground))
        total = xp.logaddexp(total, color + form[..., None])
    return total


def _divided(xp: Any, whole: Any, tan2: Any, layers: list[Any], has_highlight: bool) -> list[Any]:
    """Divide the model's values among spike, lobe and diffuse part, by the logarithms of the layers of each part."""
    tan2, (narrow, wide, diffuse) = xp.clip(tan2, None, MAX_TAN2)[..., None], layers
    if not has_highlight:  # Values far above the diffuse layers near the mirror direction are a highlight.
        ground = xp.minimum(whole, xp.exp(diffuse) * (2.0 + (tan2 / HALO) ** 2))
        return [0.0 * whole, whole - ground, ground]
    specular, ground = xp.logaddexp(narrow, wide), xp.exp(diffuse)
    odds, missed = xp.exp(xp.clip(specular - diffuse, -60.0, 60.0)), whole - xp.exp(specular) - ground
    s, halo = 1.0 / (1.0 + odds), 1.0 / (1.0 + xp.where(missed > 0.0, tan2 / HALO, tan2 / EXCESS_HALO) ** 2)
    rest = odds * s * (whole + missed * (1.0 - halo) * s * (1.0 + s * (1.0 + s))) + missed * halo * s
    rest, v, core = xp.clip(rest, 0.0, None), xp.exp(wide - specular), 1.0 / (1.0 + (tan2 / SPIKE_HALO) ** 2)
    narrower = xp.exp(narrow - specular) * (rest * (1.0 + v) * (1.0 + v**2) - xp.exp(wide) * (1.0 + v + v**2))
    spike = xp.minimum(xp.clip(narrower + core * (rest - xp.exp(wide) - narrower), 0.0, None), rest)
    return [spike, rest - spike, xp.minimum(whole, ground + (whole * s - ground) * (1.0 - halo) * s**3)]


# An exported file defines these constants for its own model; here they are placeholders.
IS_SPLINE = True
KNOTS = [[0.0]]
MAX_TANGENT = 1e12
_lobe = _hemi_epd
