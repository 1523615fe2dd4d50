"""Define the formula of exported models, and write it as a Python file for NumPy, PyTorch and JAX.

An exported file has exact numbers, copies of the functions of this module that its model needs, and at most 150 lines.
The functions use the common interface `xp` of the three libraries. Derivatives are finite wherever values are finite,
because arguments of roots and denominators are kept above 0. Parameters and formulas are as in `dsbrdf.model.dsbrdf`,
`dsbrdf.components.layers` and `dsbrdf.components.shares`.

Shaders and renderers run the file on scalars of their own, see `compiled`: `xp` is then NumPy with arrays of objects,
which compute by Python's operators and by the functions that `array_library` is given.
"""

import inspect
import itertools
import math
import operator
import sys
from collections.abc import Callable, Iterable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy

from dsbrdf.components.component import Component
from dsbrdf.components.layers import Layer, LayeredModel
from dsbrdf.components.points import COAT_F0, COAT_INDEX, MAX_TAN2, MIN_COSINE, MIN_RISE, MIN_SINE
from dsbrdf.components.shares import EXCESS_HALO_TAN2, HALO_TAN2, LABELS, MIN_LIGHT
from dsbrdf.data.geometry import CENTER_CUTOFF
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import FAMILIES, GRAZING_COSINE
from dsbrdf.output.export.templates import filled, sections
from dsbrdf.version import __version__


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
    total, difference, low = first + second, first - second, math.sqrt(xp.finfo(first.dtype).tiny)
    sum2, gap2, radius2 = (xp.clip((v * v).sum(-1), low, None) for v in (total, difference, total[..., :2]))
    x, y, z, dx, dy, dz = (v[..., i] for v in (total, difference) for i in range(3))
    along2, across2 = (z * (x * dx + y * dy) - radius2 * dz) ** 2 + low, sum2 * (x * dy - y * dx) ** 2
    lowest, diff = xp.minimum(first[..., 2], second[..., 2]), (xp.arctan(xp.sqrt(gap2 / sum2)), gap2 / (sum2 + gap2))
    return (lowest >= -1e-12)[..., None], diff, radius2 / xp.clip(z * z, 1e-18, None), along2 / (along2 + across2)


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


def _model(xp: Any, diff: tuple[Any, Any], tan2: Any, cos2_phi: Any, p: dict[str, Any]) -> Any:
    """Return the RGB values (..., 3) of the model: the sum of the lobes and the delta term of the paper."""
    theta_diff, (degree, log, exp) = diff[0], (3, xp.log, xp.exp) if IS_SPLINE else (1, xp.positive, xp.positive)
    kappa, gamma = (exp(_spline(xp, KNOTS[1], log(p[name]), theta_diff, degree)) for name in ("kappa", "gamma"))
    tangent = xp.tan(_spline(xp, KNOTS[1], p["center"], theta_diff, degree))
    log, exp = (xp.log, xp.exp) if IS_SPLINE else (xp.log1p, xp.expm1)
    amplitude = exp(_spline(xp, KNOTS[0], log(p["amplitude"]), theta_diff, degree))
    cosine4 = GRAZING_COSINE**4 + (1.0 - GRAZING_COSINE**4) * (1.0 - diff[1]) ** 2
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


def _rise(xp: Any, cosine: Any, bent: Any) -> Any:
    """Return the reflectance of glass, scaled from 0 to 1; `bent` is 1.5 times the cosine of refracted directions."""
    square = ((cosine * (bent + cosine) - 1.0) / (cosine * (bent - cosine) + 1.0)) ** 2
    return xp.clip(0.5 * ((bent - cosine) / (bent + cosine)) ** 2 * (1.0 + square) - COAT_F0, 0.0, None) / (1 - COAT_F0)


def _facets(xp: Any, cos_in: Any, cos_out: Any, tan2: Any, square: Any, tail: Any, masking: Any) -> Any:
    """Return the logarithm of a rough surface's distribution of facets times masking; `square` is alpha**2."""
    to_in, to_out = (xp.sqrt(square + (1.0 - square) * cosine**2) for cosine in (cos_in, cos_out))
    seen, both = cos_out * to_in + cos_in * to_out, (cos_in + to_in) * (cos_out + to_out)
    tails = tail * xp.log1p(8.0 * tan2 / square / (1.0 + xp.logaddexp(8.0 * tail - 9.0, 0.0 * tail)))
    return 2.0 * xp.log1p(tan2) - tails + masking * xp.log(2.0 * seen / both) - xp.log(2.0 * math.pi * square * seen)


def _layers(xp: Any, pair: tuple[Any, Any], diff: Any, tan2: Any, parameters: dict[str, Any], names: Any) -> Any:
    """Return the logarithm of the sum of the layers with the given names (..., 3)."""
    cos_in, cos_out = (xp.clip(omega[..., 2], MIN_COSINE, 1.0) for omega in pair)
    u, sin2, tan2 = diff[1] / (1.0 + xp.sqrt(1.0 - diff[1])), diff[1], xp.clip(tan2, None, MAX_TAN2)
    bent_in, bent_out, bent = (xp.sqrt(1.25 + cosine**2) for cosine in (cos_in, cos_out, 1.0 - u))
    to_in, to_out, fresnel = _rise(xp, cos_in, bent_in), _rise(xp, cos_out, bent_out), _rise(xp, 1.0 - u, bent)
    ratio, spread = ((cos_in + cos_out) / (bent_in + bent_out)) ** 2, cos_in * cos_out / (bent_in * bent_out)
    passed, sin2_half = xp.log((1.0 - to_in) * (1.0 - to_out)), tan2 / (1.0 + tan2)
    total = 0.0 * u[..., None] - 1e4  # The logarithm -1e4 stands for a sum without layers, because exp(-1e4) is 0.
    for name in names:
        p = {key.rpartition(".")[2]: value for key, value in parameters.items() if key.rpartition(".")[0] == name}
        if "f0" in p:  # Only specular layers have F0.
            form = p["rise"][0] * u + p["rise"][1] * u**2 + p["under_coat"] * (passed + 2.0 * math.log1p(-COAT_F0))
            form = form + p["refraction"] * xp.log(spread)
            color = xp.log(p["f0"] + (p["f90"] - p["f0"]) * (fresnel + p["schlick"] * (u**5 - fresnel))[..., None])
            color = color + p["turn"][0] * sin2_half[..., None] + p["turn"][1] * u[..., None] if "turn" in p else color
            below2, square = tan2 * ratio ** p["refraction"], (p["alpha"] / COAT_INDEX ** p["refraction"]) ** 2
            form = form + _facets(xp, cos_in, cos_out, below2, square, p["tail_exponent"], p["masking"])
        elif "alpha" in p:  # Of the other layers, only retro layers have a roughness alpha.
            back2 = xp.clip(4.0 * sin2 - (cos_in - cos_out) ** 2, 0.0, None) / (cos_in + cos_out) ** 2
            color, form = xp.log(p["color"]), _facets(xp, cos_in, cos_out, back2, p["alpha"] ** 2, 0.0 * u + 2.0, 0.0)
        elif "powers" in p:  # Only sheen layers have powers.
            log_u, log_sin2 = xp.log(xp.clip(u, MIN_RISE, None)), xp.log(xp.clip(sin2_half, MIN_SINE**2, None))
            color, form = xp.log(p["color"]), p["powers"][0] * log_u + p["powers"][1] / 2.0 * log_sin2
        else:
            along = xp.where((x := 1.0 - 2.0 * sin2 - cos_in * cos_out) > 0.0, x / xp.maximum(cos_in, cos_out), x)
            form = passed, (1.0 - sin2) * (to_in + to_out), fresnel, xp.log(2.0 / (cos_in + cos_out)), sin2_half, along
            color, form = xp.log(p["albedo"] / math.pi), sum(p["exponents"][i] * one for i, one in enumerate(form))
        total = xp.logaddexp(total, color + form[..., None])
    return total


def _divided(xp: Any, whole: Any, tan2: Any, layers: list[Any], has_highlight: bool) -> list[Any]:
    """Divide the model's values among spike, lobe and diffuse part, by the logarithms of the layers of each part."""
    tan2, (narrow, wide, diffuse) = xp.clip(tan2, None, MAX_TAN2)[..., None], map(xp.exp, layers)
    if not has_highlight:  # Values far above the diffuse layers near the mirror direction are a highlight.
        return [0.0 * whole, whole - (ground := xp.minimum(whole, diffuse * (2.0 + (tan2 / HALO_TAN2) ** 2))), ground]
    rest, parts, missed = whole, [], (whole - narrow - wide - diffuse).sum(-1)[..., None]
    outside = 1.0 - 1.0 / (1.0 + xp.where(missed > 0.0, tan2 / HALO_TAN2, tan2 / EXCESS_HALO_TAN2) ** 2)
    for own, other, gain, power, tint in ((diffuse, narrow + wide, outside, 3, 3), (wide, narrow, 1.0, 2, 0)):
        light, of_own, of_other = (one.sum(-1)[..., None] + MIN_LIGHT for one in (rest, own, other))
        part = xp.minimum(light, of_own + gain * (f := of_own / (of_own + of_other)) ** power * (light * f - of_own))
        own, other = own * (part / of_own), other * ((light - part) / of_other) + MIN_LIGHT
        parts.append(xp.minimum(rest, own * (1.0 - (f := own / (own + other)) ** tint) + rest * f ** (tint + 1)))
        rest = rest - parts[-1]
    return [rest, *reversed(parts)]


# An exported file defines these constants for its own model; here they are placeholders.
IS_SPLINE = True
KNOTS = [[0.0]]
MAX_TANGENT = 1e12
_lobe = _hemi_epd

_Numbers = dict[str, Any]
_Functions = tuple[Callable[..., Any], ...]
_TEMPLATES = sections("python_file.txt")
_LOBE_FUNCTIONS: dict[str, Callable[..., Any]] = {"hemi_epd": _hemi_epd, "student": _student}
_LAYER_FUNCTIONS: _Functions = (_rise, _facets, _layers)
_CONSTANTS = (
    *("GRAZING_COSINE", "CENTER_CUTOFF", "COAT_F0", "COAT_INDEX", "HALO_TAN2", "EXCESS_HALO_TAN2"),
    *("MIN_COSINE", "MAX_TAN2", "MIN_RISE", "MIN_SINE", "MIN_LIGHT"),
)


def python_file(source: DSBRDF | LayeredModel | Component) -> str:
    """Return Python source with ``evaluate(omega_in, omega_out, parameters=PARAMETERS)``, independent of dsbrdf."""
    if isinstance(source, LayeredModel):
        layers = _layer_parameters(source.layers, "")
        return _file("its physical layers", "layers", layers, {"LAYERS": tuple(layers)}, _LAYER_FUNCTIONS)
    if isinstance(source, DSBRDF):
        return _model_file("all of it", source)
    whole, part = source.whole, f"its {source.label.replace('_', ' ')}"
    if len(whole.labels) < 2:  # If the model has a single component, this component equals the whole model.
        return _model_file(part, whole.model)
    numbers: _Numbers = {}
    structures = []
    for number, structure in enumerate(whole.structures, 1):
        layers = _layer_parameters(structure.model.layers, f"structure_{number}.")
        numbers |= {f"structure_{number}.weight": structure.weight}
        numbers |= {name: value for line in layers.values() for name, value in line.items()}
        named = [*zip(layers, structure.labels, strict=True)]
        structures.append(tuple(tuple(name for name, own in named if own == label) for label in LABELS))
    shown = tuple(float(whole.receiver(label) == source.label) for label in LABELS)
    fixed = {"SHOWN": shown, "STRUCTURES": tuple(structures)}
    return _model_file(part, whole.model, "component", {"structures": numbers}, fixed, (*_LAYER_FUNCTIONS, _divided))


def _model_file(
    part: str,
    model: DSBRDF,
    evaluate: str = "model",
    more_parameters: dict[str, _Numbers] | None = None,
    more_constants: _Numbers | None = None,
    more_functions: _Functions = (),
) -> str:
    """Return a file with the parameters, constants and functions of a model, and more of each."""
    names = ("amplitude", "kappa", "gamma", "center", "elongation")
    parameters = {name: {name: getattr(model, name).tolist()} for name in names}
    if model.delta.any():
        parameters["delta"] = {"delta": model.delta[..., numpy.newaxis].tolist()}
    knots = [one.tolist() for one in (model.theta_diff, model.shape_theta_diff, model.elongation_theta_diff)]
    constants = {"KNOTS": knots, "IS_SPLINE": model.interpolation == "spline"}
    constants |= {"MAX_TANGENT": FAMILIES[model.lobe].largest_tangent} | (more_constants or {})
    functions: _Functions = (_spline, _LOBE_FUNCTIONS[model.lobe], _model, *more_functions)
    return _file(part, evaluate, parameters | (more_parameters or {}), constants, functions)


def _layer_parameters(layers: tuple[Layer, ...], lead: str) -> dict[str, _Numbers]:
    """Return the parameters of layers by name, such as ``specular_1.alpha``; the exported file has a line per layer."""
    named = {f"{lead}{type(one).__name__.removesuffix('Layer').lower()}_{n}": one for n, one in enumerate(layers, 1)}
    return {
        name: {f"{name}.{parameter}": numpy.asarray(value).tolist() for parameter, value in vars(layer).items()}
        for name, layer in named.items()
    }


def _file(part: str, evaluate: str, parameters: dict[str, _Numbers], constants: _Numbers, functions: _Functions) -> str:
    """Return the whole file; the template's section `evaluate` becomes the last function of the file."""
    used: _Functions = (_arrays, _angles, *functions)
    body = "\n".join([*map(inspect.getsource, used), _TEMPLATES[evaluate]])
    for name in _LOBE_FUNCTIONS:
        body = body.replace(f"_{name}(", "_lobe(")
    numbers = [" ".join(f'"{name}": {value!r},' for name, value in line.items()) for line in parameters.values()]
    lines = [filled(_TEMPLATES["head"], {"VERSION": __version__, "PART": part}), "PARAMETERS: dict[str, Any] = {"]
    lines += [f"    {line}" for line in numbers] + ["}"]
    constants |= {name: globals()[name] for name in _CONSTANTS if name in body}
    lines += [f"{', '.join(constants)} = {', '.join(map(repr, constants.values()))}", "", body]
    return "\n".join(lines)


def compiled(source: DSBRDF | LayeredModel | Component, xp: Any) -> Callable[..., Any]:
    """Return ``evaluate`` of the exported file as a function that computes with the array library `xp`.

    The function takes arrays (..., 3) of directions, then ``shown`` and parameters that replace others by their names.
    """
    file: dict[str, Any] = {}
    exec(python_file(source), file)  # noqa: S102 (the file has just been written) # nosec B102
    numbers = {name: numpy.asarray(value) for name, value in file["PARAMETERS"].items()}
    file["_arrays"] = lambda parameters, *directions: (xp, *directions, parameters)

    def evaluate(*directions: Any, shown: Any = None, **changed: Any) -> Any:
        weights = {} if shown is None or "SHOWN" not in file else {"shown": shown}
        with numpy.errstate(all="ignore"):  # Other libraries leave marks of invalid numbers, which NumPy would report.
            return file["evaluate"](*directions, numbers | changed, **weights)

    return evaluate


FUNCTIONS = ("sqrt", "exp", "log", "sin", "cos", "tan", "arctan", "expm1", "log1p")
"""Functions of one number that the formula calls."""


class ScalarArray(numpy.ndarray):
    """Array of scalars whose comparisons return what the scalars return, where NumPy's own would return booleans."""


for _name in ("lt", "ge", "gt", "eq", "and_", "or_"):
    _each = numpy.frompyfunc(getattr(operator, _name), 2, 1)
    setattr(ScalarArray, f"__{_name.strip('_')}__", lambda a, b, each=_each: each(a, b))


def direction(components: Iterable[Any]) -> Any:
    """Return an array (1, 3) of a direction's components."""
    array = numpy.empty((1, 3), dtype=object)
    for index, component in enumerate(components):  # NumPy would look into a scalar of drjit if it were in a list.
        array[0, index] = component
    return array.view(ScalarArray)


def array_library(is_scalar: Callable[[Any], bool], functions: Mapping[str, Callable[..., Any]]) -> Any:
    """Return the array library in which the formula computes with scalars.

    The mapping has the functions in `FUNCTIONS`, and ``minimum``, ``maximum`` and ``where``. They are called only if an
    argument is a scalar; a function of plain numbers is computed at once.
    """

    def each(name: str, of_numbers: Callable[..., Any], count: int) -> Any:
        def call(*arguments: Any) -> Any:
            # Return a Python float: a NumPy number times one of our scalars would treat the scalar as an array.
            return functions[name](*arguments) if any(map(is_scalar, arguments)) else float(of_numbers(*arguments))

        return numpy.frompyfunc(call, count, 1)

    def clip(x: Any, low: Any, high: Any) -> Any:
        x = x if low is None else maximum(x, low)
        return x if high is None else minimum(x, high)

    def logaddexp(a: Any, b: Any) -> Any:
        high = maximum(a, b)
        return high + of_one["log1p"](of_one["exp"](minimum(a, b) - high))

    def where(condition: Any, first: Any, second: Any) -> Any:
        if not is_scalar(condition):
            return first if condition else second
        return first if first is second else functions["where"](condition, first, second)

    of_one = {name: each(name, getattr(numpy, name), 1) for name in FUNCTIONS}
    minimum, maximum = each("minimum", min, 2), each("maximum", max, 2)
    return SimpleNamespace(
        **of_one,
        clip=clip,
        minimum=minimum,
        maximum=maximum,
        logaddexp=logaddexp,
        where=numpy.frompyfunc(where, 3, 1),
        positive=lambda x: x,
        asarray=numpy.asarray,
        ones_like=lambda x: 1.0 + 0.0 * x,
        zeros_like=lambda x: 0.0 * x,
        finfo=lambda _: numpy.finfo(numpy.float32),
    )
