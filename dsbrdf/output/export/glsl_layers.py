"""Write physical layers in GLSL: a layered model as a readable function, and the division of a model into components.

The functions of the layers return logarithms: far from the highlight, values are too small for single precision, but
their ratios are not. A component's function evaluates the model and the layers of each structure once. It divides the
model as `dsbrdf.components.shares` does, with the formula rearranged against cancellation: with s the diffuse
fraction of the layers, their sum g, and a = q / (1 + q) where f > g, else 1,

    diffuse = min(f, g s (1 - a s**3) + f a s**4),
    specular = max(0, (1 - s) (f + (f - g) a (s + s**2 + s**3)) + (f - g) (1 - a) s),
    spike = max(0, n (specular (1 + v) (1 + v**2) - l (1 + v + v**2))),

where l is the light of the lobe's layers, v its fraction of the specular layers' light, and n = 1 - v.
"""

from collections.abc import Sequence

import numpy as np

from dsbrdf.components.decomposition import Component, Decomposition
from dsbrdf.components.layers import DiffuseLayer, Layer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer, tail_norm
from dsbrdf.components.points import COAT_F0, MAX_TAN2, MIN_COSINE, MIN_RISE, MIN_SINE
from dsbrdf.components.shares import HALO, LABELS, WeightedLayers
from dsbrdf.output.export.single_precision import filled, literal

_NO_LIGHT = "vec3(-1e30)"  # logarithm of an absent layer


def layered_function(model: LayeredModel) -> str:
    """Return ``vec3 dsbrdf(vec3 omega_in, vec3 omega_out)``, and the functions that it needs."""
    terms = "\n    + ".join(f"exp({_call(layer)})" for layer in model.layers) or "vec3(0.0)"
    return _HEADER + layer_functions(model.layers) + _LAYERED.replace("TERMS", terms)


def layer_functions(layers: Sequence[Layer]) -> str:
    """Return ``dsbrdf_pair``, and a function for each kind of layer, such as ``dsbrdf_diffuse``."""
    kinds = {type(layer) for layer in layers}
    text = _PAIR
    if kinds & {SpecularLayer, RetroLayer}:
        text += _SURFACE
    text += "".join(function for kind, function in _FUNCTIONS.items() if kind in kinds)
    limits = {"COSINE": MIN_COSINE, "TANGENT": MAX_TAN2, "RISE": MIN_RISE, "SINE2": MIN_SINE**2}
    limits |= {"COAT": COAT_F0, "CLEAR": -2.0 * float(np.log(1.0 - COAT_F0))}
    return filled(text, {word: literal(value) for word, value in limits.items()})


def shares_function(component: Component) -> str:
    """Return ``dsbrdf_shown``, which needs ``dsbrdf_model``."""
    whole = component.whole
    if len(whole.labels) < 2:
        return _ONLY_COMPONENT.replace("SHOWN", "xyz"[LABELS.index(component.label)])
    layers = [layer for structure in whole.structures for layer in structure.model.layers]
    parts = "\n    + ".join(map(_divided, whole.structures))
    heirs = ", ".join(f"shown.{'xyz'[place]}" for place in _receivers(whole))
    words: dict[str, str | int] = {"PARTS": parts, "RECEIVERS": heirs, "HALO": literal(HALO)}
    return layer_functions(layers) + filled(_DIVISION_OF_MODEL, words)


def _receivers(whole: Decomposition) -> list[int]:
    """Return for each of `LABELS` the index of the component that receives the light of its layers."""
    return [LABELS.index(whole.receiver(label)) for label in LABELS]


def _divided(structure: WeightedLayers) -> str:
    """Return an expression for the parts of a model by one structure, times its weight."""
    logs = [_NO_LIGHT] * len(LABELS)
    for layer, label in zip(structure.model.layers, structure.labels, strict=True):
        place = LABELS.index(label)
        logs[place] = _call(layer) if logs[place] == _NO_LIGHT else f"dsbrdf_both({logs[place]},\n      {_call(layer)})"
    if logs[0] == logs[1] == _NO_LIGHT:
        parts = f"dsbrdf_ground(p.tangent2, whole, {logs[2]})"
    else:
        parts = ",\n      ".join(("dsbrdf_divided(p.tangent2, whole", *logs)) + ")"
    return f"{literal(structure.weight)} * {parts}"


def _call(layer: Layer) -> str:
    """Return the logarithm of a layer as an expression."""
    match layer:
        case SpecularLayer():
            facets = _facets(layer.alpha, layer.tail_exponent, layer.masking)
            fresnel, bend = f"{_list(layer.f0)}, {_short(layer.f90)}", _list((*layer.rise, layer.under_coat))
            return f"dsbrdf_specular(p, {fresnel},\n      {facets}, {bend})"
        case RetroLayer():
            return f"dsbrdf_retro(p, {_list(layer.color)}, {_facets(layer.alpha, 2.0, 0.0)})"
        case DiffuseLayer():
            exponents = f"{_list(layer.exponents[:3])}, {_list(layer.exponents[3:])}"
            return f"dsbrdf_diffuse(p, {_list(layer.albedo)},\n      {exponents})"
        case SheenLayer():
            return f"dsbrdf_sheen(p, {_list(layer.color)}, {_list(layer.powers)})"


def _facets(alpha: float, tail_exponent: float, masking: float) -> str:
    return _list((alpha, tail_exponent, tail_norm(tail_exponent)[0], masking))


def _list(values: Sequence[float]) -> str:
    return f"vec{len(values)}({', '.join(map(_short, values))})"


def _short(value: float) -> str:
    """Return a number with six digits, enough for single precision."""
    return literal(float(f"{value:.6g}"))


_HEADER = """\
// vec3 dsbrdf(vec3 omega_in, vec3 omega_out) is a measured BRDF as the sum of a few physical layers, without cosine,
// in 1/sr for linear red, green and blue. Directions are unit vectors away from the surface, in the frame whose z axis
// is the normal; below the horizon it is 0. Needs GLSL ES 3.00 (WebGL 2) or GLSL 3.30; mediump is too coarse.
precision highp float;

"""

_PAIR = """\
struct dsbrdf_Pair {
  vec2 cosines; vec3 risen;           // cosines to the normal; rise of glass's reflectance there and at theta_diff
  float swing2, rise;                 // squared sine of theta_diff; 1 - cos(theta_diff)
  float sine2, tangent2, passed;      // squared sine, tangent of theta_half; log of the light that passes a surface
};

dsbrdf_Pair dsbrdf_pair(vec3 omega_in, vec3 omega_out) {
  dsbrdf_Pair p;
  vec3 total = omega_in + omega_out, difference = omega_in - omega_out;
  float total2 = max(dot(total, total), 1e-30), difference2 = dot(difference, difference);
  p.cosines = clamp(vec2(omega_in.z, omega_out.z), COSINE, 1.0);
  p.swing2 = difference2 / (total2 + difference2);
  p.rise = p.swing2 / (1.0 + sqrt(1.0 - p.swing2));
  vec3 cosine = vec3(p.cosines, 1.0 - p.rise), refracted = sqrt(1.25 + cosine * cosine);
  vec3 across = (refracted - cosine) / (refracted + cosine);
  vec3 ratio = (cosine * (refracted + cosine) - 1.0) / (cosine * (refracted - cosine) + 1.0);
  p.risen = max(0.5 * across * across * (1.0 + ratio * ratio) - COAT, 0.0) / (1.0 - COAT);
  p.passed = log((1.0 - p.risen.x) * (1.0 - p.risen.y));
  p.sine2 = min(dot(total.xy, total.xy) / total2, 1.0);
  p.tangent2 = min(dot(total.xy, total.xy) / max(total.z * total.z, 1e-30), TANGENT);
  return p;
}

"""

_SURFACE = """\
// Return log(D V), facets and masking; facets holds alpha, tail exponent (2 is GGX), norm of D, form of masking.
float dsbrdf_surface(dsbrdf_Pair p, float tangent2, vec4 facets) {
  float alpha2 = facets.x * facets.x, slope = tangent2 / (facets.z * alpha2);
  vec2 seen = sqrt(alpha2 + (1.0 - alpha2) * p.cosines * p.cosines), apart = p.cosines + seen;
  float together = dot(p.cosines.yx, seen);
  return facets.w * log(2.0 * together / (apart.x * apart.y)) - log(6.2831853 * alpha2 * together)
    + 2.0 * log(1.0 + tangent2) - facets.y * log(1.0 + slope);
}

"""

_FUNCTIONS: dict[type[Layer], str] = {
    SpecularLayer: """\
// bend holds two exponents for reflectance unlike glass, and 1 for a surface below a clear coat.
vec3 dsbrdf_specular(dsbrdf_Pair p, vec3 f0, float f90, vec4 facets, vec3 bend) {
  float bent = dot(bend, vec3(p.rise, p.rise * p.rise, p.passed - CLEAR));
  return log(mix(f0, vec3(f90), p.risen.z)) + (dsbrdf_surface(p, p.tangent2, facets) + bent);
}

""",
    RetroLayer: """\
// Light returns to its source: theta_half is computed with omega_in turned by 180 degrees.
vec3 dsbrdf_retro(dsbrdf_Pair p, vec3 color, vec4 facets) {
  float height = p.cosines.x + p.cosines.y, step = p.cosines.x - p.cosines.y;
  float tangent2 = max(4.0 * p.swing2 - step * step, 0.0) / (height * height);
  return log(color) + dsbrdf_surface(p, tangent2, facets);
}

""",
    DiffuseLayer: """\
// first holds the exponents of passed light, retro-reflection and rise; second: limb, theta_half, Oren and Nayar.
vec3 dsbrdf_diffuse(dsbrdf_Pair p, vec3 albedo, vec3 first, vec3 second) {
  float limb = log(2.0 / (p.cosines.x + p.cosines.y)), along = 1.0 - 2.0 * p.swing2 - p.cosines.x * p.cosines.y;
  if (along > 0.0) along /= max(p.cosines.x, p.cosines.y);
  vec3 ground = vec3(p.passed, (1.0 - p.swing2) * (p.risen.x + p.risen.y), p.risen.z);
  return log(albedo / 3.14159265) + (dot(first, ground) + dot(second, vec3(limb, p.sine2, along)));
}

""",
    SheenLayer: """\
// Fibres scatter light at grazing angles, with powers of 1 - cos(theta_diff) and of sin(theta_half).
vec3 dsbrdf_sheen(dsbrdf_Pair p, vec3 color, vec2 powers) {
  return log(color) + dot(powers, log(vec2(max(p.rise, RISE), sqrt(max(p.sine2, SINE2)))));
}

""",
}

_LAYERED = """\
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  dsbrdf_Pair p = dsbrdf_pair(omega_in, omega_out);
  return TERMS;
}
"""

_ONLY_COMPONENT = """\
vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  return shown.SHOWN * dsbrdf_model(dsbrdf_angles(omega_in, omega_out));
}

"""

_DIVISION_OF_MODEL = """\
// Return log(exp(first) + exp(second)) without overflow.
vec3 dsbrdf_both(vec3 first, vec3 second) {
  vec3 top = max(first, second);
  return top + log(exp(first - top) + exp(second - top));
}

// Divide the model into specular spike, specular lobe and diffuse part, by the logarithms of their layers.
mat3 dsbrdf_divided(float tangent2, vec3 whole, vec3 narrow, vec3 wide, vec3 diffuse) {
  vec3 specular = dsbrdf_both(narrow, wide), odds = exp(clamp(specular - diffuse, -60.0, 60.0));
  vec3 s = 1.0 / (1.0 + odds), ground = exp(diffuse), missed = whole - exp(specular) - ground;
  float q = tangent2 / HALO;
  vec3 halo = vec3(greaterThan(missed, vec3(0.0))) / (1.0 + q * q), beyond = 1.0 - halo, taken = beyond * s * s * s;
  vec3 highlight = whole + missed * beyond * s * (1.0 + s * (1.0 + s));
  vec3 rest = max(odds * s * highlight + missed * halo * s, 0.0), v = exp(wide - specular);
  vec3 spike = exp(narrow - specular) * (rest * (1.0 + v) * (1.0 + v * v) - exp(wide) * (1.0 + v * (1.0 + v)));
  spike = clamp(spike, vec3(0.0), rest);
  return mat3(spike, rest - spike, min(whole, ground * (1.0 - taken) + whole * taken * s));
}

// Divide the model if the layers are only a ground: much brighter light near the mirror direction is a highlight.
mat3 dsbrdf_ground(float tangent2, vec3 whole, vec3 diffuse) {
  float q = tangent2 / HALO;
  vec3 ground = min(whole, exp(diffuse) * (2.0 + q * q));
  return mat3(vec3(0.0), whole - ground, ground);
}

vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  vec3 whole = dsbrdf_model(dsbrdf_angles(omega_in, omega_out));
  dsbrdf_Pair p = dsbrdf_pair(omega_in, omega_out);
  // The mean over the structures of layers that explain the model.
  mat3 parts = PARTS;
  return parts * vec3(RECEIVERS);
}

"""
