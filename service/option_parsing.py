"""Fit options of a request: what a query or a JSON document gives, checked against the library's types."""

import types
from collections.abc import Iterable, Mapping
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from dsbrdf import FitOptions, InvalidArgumentError
from service.options import WIRE_TYPES, from_wire

_CHECKS = {name: TypeAdapter(hint) for name, hint in WIRE_TYPES.items()}


def parse_options(values: Mapping[str, Any]) -> FitOptions:
    """Return the options for values under wire names; ``none`` stands for None, what is not given is the default.

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
    return from_wire({name: _checked(name, value) for name, value in values.items()})


def parse_query(items: Iterable[tuple[str, str]]) -> FitOptions:
    """Return the options for the parameters of a query; commas part a list.

    Raises
    ------
    InvalidArgumentError
        As `parse_options`, or if an option is given twice.
    """
    values: dict[str, Any] = {}
    for name, text in items:
        if name in values:
            raise InvalidArgumentError(f"The option {name[:60]!r} is given more than once; give it once.")
        values[name] = _from_text(name, text)
    return parse_options(values)


def _from_text(name: str, text: str) -> Any:
    if "," in text and tuple in _kinds(WIRE_TYPES.get(name)):
        return text.split(",")
    return text


def _checked(name: str, value: Any) -> Any:
    hint = WIRE_TYPES[name]
    if isinstance(value, str) and value.lower() in ("none", "null"):
        value = None
    try:
        if not isinstance(value, bool) or bool in _kinds(hint):  # True would pass for 1
            return _CHECKS[name].validate_python(value)
    except ValidationError:
        raise _wrong_type(name, value) from None
    raise _wrong_type(name, value)


def _wrong_type(name: str, value: Any) -> InvalidArgumentError:
    expected = " or ".join(_described(WIRE_TYPES[name]))
    return InvalidArgumentError(f"{name} must be {expected}, not {str(value)[:60]!r}.")


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
