"""Fit options on the wire: those of the library, with angles in degrees and names that end in ``_deg``.

Names, types and defaults are taken from `dsbrdf.FitOptions`, so that they cannot drift apart.
"""

import types
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from dsbrdf import FitOptions, InvalidArgumentError

_ANGLES = ("horizon_cutoff", "knots")  # radians in the library, degrees on the wire
_WIRE_NAMES = {field.name: f"{field.name}_deg" if field.name in _ANGLES else field.name for field in fields(FitOptions)}
WIRE_TYPES: dict[str, Any] = {_WIRE_NAMES[name]: hint for name, hint in get_type_hints(FitOptions).items()}
_CHECKS = {name: TypeAdapter(hint) for name, hint in WIRE_TYPES.items()}
_DECIMALS = 9  # of a degree: takes off what the conversion to radians and back has added


def to_wire(options: FitOptions) -> dict[str, Any]:
    """Return the options under their wire names, in JSON's types; equal options give equal dicts."""
    return {wire: _to_degrees(name, getattr(options, name)) for name, wire in _WIRE_NAMES.items()}


def from_wire(values: Mapping[str, Any]) -> FitOptions:
    """Return the options for values under wire names; what is not given keeps its default.

    Raises
    ------
    InvalidArgumentError
        If a name is unknown, or a value is of a wrong type or out of range.
    """
    unknown = [name for name in values if name not in WIRE_TYPES]
    if unknown:
        names = ", ".join(repr(name[:60]) for name in unknown[:5])
        plural = "options" if len(unknown) > 1 else "option"
        raise InvalidArgumentError(f"Unknown {plural} {names}; known options are {', '.join(WIRE_TYPES)}.")
    library = {}
    for name, wire in _WIRE_NAMES.items():
        if wire in values:
            library[name] = _to_radians(name, _checked(wire, values[wire]))
    return FitOptions(**library)


def from_query(items: Iterable[tuple[str, str]]) -> FitOptions:
    """Return the options for the parameters of a query; ``none`` stands for None, commas part a list.

    Raises
    ------
    InvalidArgumentError
        As `from_wire`, or if an option is given twice.
    """
    values: dict[str, Any] = {}
    for name, text in items:
        if name in values:
            raise InvalidArgumentError(f"The option {name[:60]!r} is given more than once; give it once.")
        values[name] = _from_text(name, text)
    return from_wire(values)


def _from_text(name: str, text: str) -> Any:
    if text.lower() in ("none", "null"):
        return None
    if tuple in _kinds(WIRE_TYPES.get(name)) and text != "auto":
        return text.split(",")
    return text


def _checked(wire: str, value: Any) -> Any:
    try:
        if not isinstance(value, bool) or bool in _kinds(WIRE_TYPES[wire]):  # True would pass for 1
            return _CHECKS[wire].validate_python(value)
    except ValidationError:
        raise _wrong_type(wire, value) from None
    raise _wrong_type(wire, value)


def _wrong_type(wire: str, value: Any) -> InvalidArgumentError:
    expected = " or ".join(_described(WIRE_TYPES[wire]))
    return InvalidArgumentError(f"{wire} must be {expected}, not {str(value)[:60]!r}.")


def _described(hint: Any) -> list[str]:
    """Return the kinds of value that a type allows, in words."""
    if get_origin(hint) in (Union, types.UnionType):
        return [word for part in get_args(hint) for word in _described(part)]
    if get_origin(hint) is Literal:
        return [repr(value) for value in get_args(hint)]
    if get_origin(hint) is tuple:
        return ["a list of numbers"]
    return [{int: "an integer", float: "a number", bool: "true or false", type(None): "none"}[hint]]


def _kinds(hint: Any) -> set[Any]:
    if get_origin(hint) in (Union, types.UnionType):
        return {kind for part in get_args(hint) for kind in _kinds(part)}
    return {get_origin(hint) or hint}


def _to_degrees(name: str, value: Any) -> Any:
    if isinstance(value, tuple):
        return [_to_degrees(name, item) for item in value]
    if name in _ANGLES and isinstance(value, (int, float)):
        return round(float(np.degrees(value)), _DECIMALS)
    return value


def _to_radians(name: str, value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_to_radians(name, item) for item in value)
    if name in _ANGLES and isinstance(value, (int, float)):
        return float(np.radians(value))
    return value


DEFAULTS = to_wire(FitOptions())
