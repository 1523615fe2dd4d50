"""Write physical layers in GLSL: a layered model as a readable function, and the division of a model into components.

The functions of the layers return logarithms, because far from the highlight values are too small for single precision,
although the ratios of the values are not. A component's function evaluates the model and each layer once, and divides
the model as `dsbrdf.components.shares` does, with the formula rearranged against cancellation. Let f be the value of
the model, g the sum of the layers, s the diffuse fraction of g, and let a rise from 0 at the mirror direction to 1
outside a halo around it. Then the components are

    diffuse = min(f, g s (1 - a s**3) + f a s**4),
    specular = max(0, (1 - s) (f + (f - g) a (s + s**2 + s**3)) + (f - g) (1 - a) s),
    spike = n (specular (1 + v) (1 + v**2) - l (1 + v + v**2)),

where l is the sum of the layers of the lobe, v the fraction of l in the sum of the specular layers, and n = 1 - v.
Inside the halo of the spike, the value of the spike tends to specular - l. The spike is clipped to the interval from 0
to specular, and the lobe is the rest of specular.
"""

from collections.abc import Sequence

import numpy as np

from dsbrdf.components.component import Component, Decomposition
from dsbrdf.components.layer_data import COAT_F0, MAX_TAN2, MIN_COSINE, MIN_RISE, MIN_SINE
from dsbrdf.components.layers import DiffuseLayer, Layer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer, tail_norm
from dsbrdf.components.shares import EXCESS_HALO, HALO, LABELS, SPIKE_HALO, WeightedLayers
from dsbrdf.output.export.single_precision import literal
from dsbrdf.output.export.templates import filled, sections

_NO_LIGHT = "vec3(-1e30)"  # logarithm of the value 0, for a layer that the model does not have
_TEMPLATES = sections("layers.glsl")


def layered_function(model: LayeredModel) -> str:
    """Return the source of ``vec3 dsbrdf(vec3 omega_in, vec3 omega_out)`` and of the functions that it calls."""
    terms = "\n    + ".join(f"exp({_call(layer)})" for layer in model.layers) or "vec3(0.0)"
    return _TEMPLATES["header"] + layer_functions(model.layers) + _TEMPLATES["layered"].replace("TERMS", terms)


def layer_functions(layers: Sequence[Layer]) -> str:
    """Return the source of ``dsbrdf_pair`` and of a function for each kind of layer, such as ``dsbrdf_diffuse``."""
    used = {"pair"} | {type(layer).__name__ for layer in layers}
    if used & {"SpecularLayer", "RetroLayer"}:
        used |= {"surface"}
    text = "".join(section for name, section in _TEMPLATES.items() if name in used)
    limits = {"COSINE": MIN_COSINE, "TANGENT": MAX_TAN2, "RISE": MIN_RISE, "SINE2": MIN_SINE**2}
    limits |= {"COAT": COAT_F0, "CLEAR": -2.0 * float(np.log(1.0 - COAT_F0))}
    return filled(text, {word: literal(value) for word, value in limits.items()})


def shares_function(component: Component) -> str:
    """Return the source of ``dsbrdf_shown``, which calls ``dsbrdf_model``."""
    whole = component.whole
    if len(whole.labels) < 2:
        return _TEMPLATES["only component"].replace("SHOWN", "xyz"[LABELS.index(component.label)])
    layers = [layer for structure in whole.structures for layer in structure.model.layers]
    parts = "\n    + ".join(map(_divided, whole.structures))
    heirs = ", ".join(f"shown.{'xyz'[place]}" for place in _receivers(whole))
    words: dict[str, str | int] = {"PARTS": parts, "RECEIVERS": heirs, "HALO": literal(HALO)}
    words |= {"NEAR": literal(HALO / EXCESS_HALO), "CORE": literal(HALO / SPIKE_HALO)}
    return layer_functions(layers) + filled(_TEMPLATES["division of model"], words)


def _receivers(whole: Decomposition) -> list[int]:
    """Return, for each label in `LABELS`, the index of the component that receives the values of its layers."""
    return [LABELS.index(whole.receiver(label)) for label in LABELS]


def _divided(structure: WeightedLayers) -> str:
    """Return a GLSL expression that divides the model by the layers of one structure, times the structure's weight."""
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
    """Return a GLSL expression for the logarithm of a layer's values."""
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
