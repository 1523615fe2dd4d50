"""Write a model, a component or layers as a Python file with a differentiable function for NumPy, PyTorch and JAX.

The file has copies of the functions of `dsbrdf.output.export.python_code` that the model needs, and exact numbers.
"""

import inspect
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from dsbrdf.components.component import Component
from dsbrdf.components.layers import Layer, LayeredModel
from dsbrdf.components.shares import LABELS
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import FAMILIES
from dsbrdf.output.export import python_code as code
from dsbrdf.output.export.templates import filled, sections
from dsbrdf.version import __version__

_TEMPLATES = sections("python_file.txt")
_CONSTANTS = (
    *("GRAZING_COSINE", "CENTER_CUTOFF", "COAT_F0", "HALO", "EXCESS_HALO", "SPIKE_HALO"),
    *("MIN_COSINE", "MAX_TAN2", "MIN_RISE", "MIN_SINE"),
)
_LOBE_FUNCTIONS = {"hemi_epd": code._hemi_epd, "student": code._student}
_KNOTS = ("theta_diff", "shape_theta_diff", "elongation_theta_diff")
_LAYER_FUNCTIONS = (code._rise, code._facets, code._layers)
_Numbers = dict[str, Any]
_Functions = tuple[Callable[..., Any], ...]


def python_file(source: DSBRDF | LayeredModel | Component) -> str:
    """Return Python source with ``evaluate(omega_in, omega_out, parameters=PARAMETERS)``, independent of dsbrdf."""
    if isinstance(source, LayeredModel):
        layers = _layer_parameters(source.layers, "")
        return _file("its physical layers", layers, {"LAYERS": tuple(layers)}, _LAYER_FUNCTIONS, "layers")
    if isinstance(source, DSBRDF):
        return _file("all of it", _model_parameters(source), _fixed(source), _of(source), "model")
    whole, what = source.whole, f"its {source.label.replace('_', ' ')}"
    if len(whole.labels) < 2:  # If the model has a single component, this component equals the whole model.
        return _file(what, _model_parameters(whole.model), _fixed(whole.model), _of(whole.model), "model")
    parameters: dict[str, _Numbers] = _model_parameters(whole.model) | {"structures": {}}
    structures = []
    for number, structure in enumerate(whole.structures, 1):
        layers = _layer_parameters(structure.model.layers, f"structure_{number}.")
        parameters["structures"] |= {f"structure_{number}.weight": structure.weight}
        parameters["structures"] |= {name: value for line in layers.values() for name, value in line.items()}
        structures.append(tuple(tuple(_with(label, layers, structure.labels)) for label in LABELS))
    shown = tuple(float(whole.receiver(label) == source.label) for label in LABELS)
    fixed = _fixed(whole.model) | {"SHOWN": shown, "STRUCTURES": tuple(structures)}
    return _file(what, parameters, fixed, (*_of(whole.model), *_LAYER_FUNCTIONS, code._divided), "component")


def _model_parameters(model: DSBRDF) -> dict[str, _Numbers]:
    """Return the parameters of a model by name; the exported file has a line for each name."""
    names = ("amplitude", "kappa", "gamma", "center", "elongation")
    parameters = {name: {name: getattr(model, name).tolist()} for name in names}
    return parameters | ({"delta": {"delta": model.delta[..., np.newaxis].tolist()}} if model.delta.any() else {})


def _fixed(model: DSBRDF) -> _Numbers:
    """Return the constants that the functions of an exported Python file use beside the parameters of the model."""
    knots = [getattr(model, name).tolist() for name in _KNOTS]
    limit = FAMILIES[model.lobe].largest_tangent
    return {"KNOTS": knots, "IS_SPLINE": model.interpolation == "spline", "MAX_TANGENT": limit}


def _of(model: DSBRDF) -> _Functions:
    """Return the functions that evaluate a model."""
    return code._spline, _LOBE_FUNCTIONS[model.lobe], code._model


def _layer_parameters(layers: tuple[Layer, ...], lead: str) -> dict[str, _Numbers]:
    """Return the parameters of layers by name, such as ``specular_1.alpha``; the exported file has a line per layer."""
    named = {f"{lead}{type(one).__name__.removesuffix('Layer').lower()}_{n}": one for n, one in enumerate(layers, 1)}
    return {
        name: {f"{name}.{parameter}": np.asarray(value).tolist() for parameter, value in vars(layer).items()}
        for name, layer in named.items()
    }


def _with(label: str, names: dict[str, _Numbers], labels: tuple[str, ...]) -> Iterator[str]:
    """Yield the names of the layers that belong to the component with one label."""
    return (name for name, own in zip(names, labels, strict=True) if own == label)


def _file(part: str, parameters: dict[str, _Numbers], fixed: _Numbers, functions: _Functions, evaluate: str) -> str:
    """Return the whole file; the template's section `evaluate` becomes the last function of the file."""
    used: _Functions = (code._arrays, code._angles, *functions)
    body = "\n".join([*(inspect.getsource(one) for one in used), _TEMPLATES[evaluate]])
    for name in _LOBE_FUNCTIONS:
        body = body.replace(f"_{name}(", "_lobe(")
    numbers = [" ".join(f'"{name}": {value!r},' for name, value in line.items()) for line in parameters.values()]
    lines = [filled(_TEMPLATES["head"], {"VERSION": __version__, "PART": part}), "PARAMETERS: dict[str, Any] = {"]
    lines += [f"    {line}" for line in numbers] + ["}"]
    lines += [f"{name} = {fixed.pop(name)!r}" for name in ("KNOTS", "STRUCTURES") if name in fixed]
    fixed |= {name: getattr(code, name) for name in _CONSTANTS if name in body}
    lines += [f"{', '.join(fixed)} = {', '.join(map(repr, fixed.values()))}", "", body]
    return "\n".join(lines)
