"""Write a model, layers or a component as a function in GLSL, for WebGL 2 (GLSL ES 3.00), OpenGL 3.3 and later.

The formula of the exported Python file runs once on symbols, and the operations of the symbols are written. Operations
on parameters alone are computed meanwhile, in double precision. Equal operations are written once.

In the template ``model.glsl``, ``dsbrdf`` stands for the name of the function. The template defines ``log1p`` and
``expm1``, which GLSL lacks, and ``tan`` and ``arctan`` with the formulas of the library Cephes, because the functions
of GLSL are too inaccurate. The sampling functions run the formulas of `dsbrdf.model.sampling` on symbols.
"""

import operator
import re
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from dsbrdf.components.component import Component
from dsbrdf.components.layers import LayeredModel
from dsbrdf.components.shares import LABELS
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.sampling import (
    ANGLES,
    DirectionSampler,
    direction_sampler,
    in_plane_of_incidence,
    mirrored,
    mirrored_density,
)
from dsbrdf.output.export.formula import FUNCTIONS, array_library, compiled, direction
from dsbrdf.output.export.templates import filled, sections
from dsbrdf.version import __version__

NAME = "dsbrdf"
"""Default name of the exported GLSL function."""
_TEMPLATES = sections("model.glsl")
_OPERATORS = {"add": "+", "sub": "-", "mul": "*", "truediv": "/"}
_COMPARISONS = {"lt": "<", "ge": ">=", "gt": ">"}
_LOGICAL_OPERATORS = {"and": "&&", "or": "||"}
_INFIX = _OPERATORS | _COMPARISONS | _LOGICAL_OPERATORS
_FUNCTION_NAMES = {"minimum": "min", "maximum": "max"}
_FUNCTION_NAMES |= {name: f"dsbrdf_{name}" for name in ("log1p", "expm1", "tan", "arctan")}
_MAX_SINGLE = 3e38  # A larger number overflows single precision.
_NAME_PATTERN = r"(?!gl_)[A-Za-z](_?[A-Za-z0-9]){0,63}"
_RESERVED_WORDS = (
    " active asm attribute buffer case cast centroid class coherent common const continue default discard do double "
    "else enum extern external false filter fixed flat float for goto half highp if in inline inout input int "
    "interface invariant layout long lowp main mediump namespace noinline noperspective out output packed partition "
    "patch precise precision public readonly resource restrict return sample shared short sizeof smooth static struct "
    "subroutine superp switch template this true typedef uint uniform union unsigned using varying void volatile "
    "while writeonly abs acos acosh all any asin asinh atan atanh bool ceil clamp cos cosh cross degrees determinant "
    "distance dot equal exp floor fract inverse isinf isnan length log max min mix mod modf normalize not pow radians "
    "reflect refract round sign sin sinh sqrt step tan tanh texture transpose trunc "
)


def glsl_function(source: DSBRDF | LayeredModel | Component, name: str = NAME, *, sampling: bool = False) -> str:
    """Return GLSL source with ``vec3 dsbrdf(vec3 omega_in, vec3 omega_out)``.

    The function returns the BRDF in 1/sr, without the cosine; directions are unit vectors in the frame whose z axis is
    the normal. Every name in the source begins with `name`, so that a program can hold several models. The source of a
    component also has ``vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown)``, the sum of its model's
    components weighted by ``shown``. With `sampling`, ``vec3 dsbrdf_sample(vec3 omega_out, vec3 random)`` and
    ``float dsbrdf_pdf(vec3 omega_in, vec3 omega_out)`` are added, see `dsbrdf.model.sampling`.

    Raises InvalidArgumentError if a parameter is too large for single precision, or GLSL does not allow the name.
    """
    if not re.fullmatch(_NAME_PATTERN, name) or f" {name} " in _RESERVED_WORDS:
        raise InvalidArgumentError(
            f"{name!r} cannot be the name of a GLSL function: it must begin with a letter, have at most 64 letters and "
            "digits with single underscores between them, and must not be a word of GLSL"
        )
    parts = ["header", *(["header of sampling"] if sampling else []), "frame"]
    if isinstance(source, Component):
        parts.append("header of component")
    text = "".join(_TEMPLATES[part] for part in (*parts, "precision", "math", "angle")) + _functions(source)
    if isinstance(source, Component):
        text = text.replace("LABEL", source.label.replace("_", " "))
    if sampling:
        sampler = direction_sampler(source.evaluate_unmasked) if isinstance(source, Component) else source.sampler
        text += _sampling_functions(sampler)
    return f"// Written by dsbrdf {__version__}.\n" + text.replace("dsbrdf", name)


def _functions(source: DSBRDF | LayeredModel | Component) -> str:
    """Return the source of ``dsbrdf``, and of ``dsbrdf_shown`` for a component."""
    omega_in, omega_out = direction(_vector("omega_in")), direction(_vector("omega_out"))
    evaluate, arguments = compiled(source, _ARRAY_LIBRARY), "vec3 omega_in, vec3 omega_out"
    if not isinstance(source, Component):
        return _function(f"vec3 dsbrdf({arguments})", evaluate(omega_in, omega_out)[0])
    shown = _vector("shown")
    weights = [shown[LABELS.index(source.whole.receiver(label))] for label in LABELS]
    value = evaluate(omega_in, omega_out, shown=weights)[0]
    if len(source.whole.labels) < 2:
        value = shown[LABELS.index(source.label)] * value
    own = ", ".join(f"{float(label == source.label)}" for label in LABELS)
    whole = _function(f"vec3 dsbrdf_shown({arguments}, vec3 shown)", value)
    return f"{whole}\nvec3 dsbrdf({arguments}) {{\n  return dsbrdf_shown(omega_in, omega_out, vec3({own}));\n}}\n"


def _sampling_functions(sampler: DirectionSampler) -> str:
    """Return the source of ``dsbrdf_sample`` and ``dsbrdf_pdf``, with the table of the sampler's mixtures."""
    share = np.diff(sampler.cumulative, axis=1, prepend=0.0)[:, :-1]
    parts = np.stack([sampler.along, sampler.across, share], axis=-1).reshape(-1, 3)
    rows = ",\n  ".join(f"vec3({', '.join(map(_literal, row))})" for row in parts.tolist())
    table = f"const vec3 dsbrdf_MIXTURE[{len(parts)}] = vec3[{len(parts)}](\n  {rows});\n"
    step = f"const float dsbrdf_STEP = {_literal(float(ANGLES[1]))};\n"
    xp = SimpleNamespace(**_SYMBOL_FUNCTIONS)
    omega_in, omega_out, (along, across, _), random = map(_vector, ("omega_in", "omega_out", "part", "random"))
    density = mirrored_density(in_plane_of_incidence(omega_in, omega_out, xp), along, across, xp)
    drawn = mirrored(omega_out, along, across, random[0], random[1:], xp)
    formulas = _function("float dsbrdf_mirrored_density(vec3 omega_in, vec3 omega_out, vec3 part)", [density])
    formulas += _function("vec3 dsbrdf_mirrored(vec3 omega_out, vec3 part, vec3 random)", drawn)
    words = {"PARTS": sampler.along.shape[1], "LAST": ANGLES.size - 1}
    return f"\n{step}{table}{formulas}{filled(_TEMPLATES['sampling'], words)}"


class _Symbol:
    """Operation on symbols and numbers, whose value only the shader knows."""

    def __init__(self, operation: str, *parts: Any) -> None:
        self.operation, self.parts = operation, parts
        self.is_logical = operation in _COMPARISONS or operation in _LOGICAL_OPERATORS

    def __pow__(self, power: float) -> Any:
        if power < 0.0 or power % 1.0:
            return _Symbol("exp", operator.mul(float(power), _Symbol("log", self)))
        return operator.mul(self, self ** (power - 1)) if power > 1 else self if power else 1.0

    def __neg__(self) -> Any:
        return operator.mul(-1.0, self)


def _binary(name: str, first: Any, second: Any) -> Any:
    """Return the symbol of an operation, or a simpler one if a part is 0, 1 or a constant condition."""
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        return NotImplemented  # The array applies the operation to each of its elements.
    if name in _LOGICAL_OPERATORS:
        for one, other in ((first, second), (second, first)):
            if not isinstance(one, _Symbol):
                return other if bool(one) == (name == "and") else one
        return _Symbol(name, first, second)
    first, second = (
        _Symbol("where", one, 1.0, 0.0) if isinstance(one, _Symbol) and one.is_logical else one
        for one in (first, second)
    )
    for number, other in ((first, second), (second, first)):
        if isinstance(number, _Symbol):
            continue
        if number == 0.0 and (name == "add" or (name == "sub" and number is second)):
            return other
        if name == "mul":
            return 0.0 if number == 0.0 else other if number == 1.0 else _Symbol(name, float(number), other)
    return _Symbol(name, first, second)


for _name in _INFIX:
    setattr(_Symbol, f"__{_name}__", lambda a, b, n=_name: _binary(n, a, b))
    setattr(_Symbol, f"__r{_name}__", lambda a, b, n=_name: _binary(n, b, a))

_SYMBOL_FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: partial(_Symbol, name) for name in (*FUNCTIONS, "minimum", "maximum", "where")
}
_ARRAY_LIBRARY = array_library(lambda x: isinstance(x, _Symbol), _SYMBOL_FUNCTIONS)


def _vector(name: str) -> list[Any]:
    """Return the components of a vector that is an argument of a GLSL function."""
    return [_Symbol("argument", f"{name}.{axis}") for axis in "xyz"]


def _literal(value: float) -> str:
    """Return a number as a literal of GLSL in single precision; a negative one stands in brackets."""
    if abs(value) > _MAX_SINGLE:
        raise InvalidArgumentError("a parameter of the model is too large for GLSL, which has single precision")
    text = str(np.float32(value)) if abs(value) > 1e-37 else "0.0"
    text = text if "." in text or "e" in text else text + ".0"
    return f"({text})" if value < 0 else text


def _function(head: str, results: Sequence[Any]) -> str:
    """Return a GLSL function that computes one or three results; an operation that is used twice has its own line."""
    name_of: dict[tuple[str, ...], str] = {}
    text_of: dict[int, str] = {}
    uses, order = Counter[str](), list[tuple[str, tuple[str, ...], _Symbol]]()

    def text(one: Any) -> str:
        """Return the name of a symbol, equal for equal operations, or a literal."""
        if not isinstance(one, _Symbol):
            return _literal(float(one))
        if id(one) not in text_of:
            if one.operation == "argument":
                text_of[id(one)] = one.parts[0]
            else:
                parts = tuple(map(text, one.parts))
                key = one.operation, *parts
                if key not in name_of:
                    name_of[key] = f"v{len(name_of)}"
                    uses.update(parts)
                    order.append((name_of[key], parts, one))
                text_of[id(one)] = name_of[key]
        return text_of[id(one)]

    names = [text(one) for one in results]
    uses.update(names)
    kind = head.partition(" ")[0]
    lines, inline = [f"{head} {{"], dict[str, str]()
    if "omega_in" in head:
        lines.append(f"  if (omega_in.z < 0.0 || omega_out.z < 0.0) return {kind}(0.0);")
    for name, parts, one in order:
        written = [inline.get(part, part) for part in parts]
        if one.operation in _INFIX:
            value = f" {_INFIX[one.operation]} ".join(written)
        elif one.operation == "where":
            value = "{} ? {} : {}".format(*written)
        else:
            value = f"{_FUNCTION_NAMES.get(one.operation, one.operation)}({', '.join(written)})"
        if uses[name] > 1:
            lines.append(f"  {'bool' if one.is_logical else 'float'} {name} = {value};")
        else:
            inline[name] = f"({value})"
    final = ", ".join(inline.get(name, name) for name in names)
    return "\n".join(["", *lines, f"  return {kind}({final});", "}", ""])
