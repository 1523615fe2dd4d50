"""Fit options of a request: what a query or a JSON document gives, checked against the library's types."""

import json
import re
import types
from collections.abc import Iterable, Mapping
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from dsbrdf import FitOptions, InvalidArgumentError
from service.wire.fit_options import WIRE_TYPES, from_wire, to_wire

_CHECKS = {name: TypeAdapter(hint) for name, hint in WIRE_TYPES.items()}
_WORDS = {"none": None, "null": None, "true": True, "false": False}
_NUMBER = re.compile(r"-?(0|[1-9][0-9]{0,17})(\.[0-9]{1,30})?(e[+-]?[0-9]{1,4})?")


def parse_options(values: Mapping[str, Any]) -> FitOptions:
    """Return the options for JSON values under wire names; what is not given is the default.

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
    options = from_wire({name: _checked(name, value) for name, value in values.items()})
    return from_wire(to_wire(options))  # with the digits that are kept, which have to be in range too


def parse_query(items: Iterable[tuple[str, str]]) -> FitOptions:
    """Return the options for the parameters of a query; commas part a list, ``none`` stands for null.

    Raises
    ------
    InvalidArgumentError
        As `parse_options`, or if an option is given twice.
    """
    values: dict[str, Any] = {}
    for name, text in items:
        if name in values:
            raise InvalidArgumentError(f"The option {name[:60]!r} is given more than once; give it once.")
        values[name] = [_from_text(part) for part in text.split(",")] if "," in text else _from_text(text)
    return parse_options(values)


def _from_text(text: str) -> Any:
    """Return the JSON value that a text stands for, itself if none."""
    word = text.strip().lower()
    if word in _WORDS:
        return _WORDS[word]
    return json.loads(word) if _NUMBER.fullmatch(word) else text


def _checked(name: str, value: Any) -> Any:
    try:
        return _CHECKS[name].validate_python(_plain(value), strict=True)
    except ValidationError:
        raise _wrong_type(name, value) from None


def _plain(value: Any) -> Any:
    """Return a JSON value with tuples for arrays, and integers for whole numbers however they are written."""
    if isinstance(value, list):
        return tuple(_plain(item) for item in value)
    return int(value) if isinstance(value, float) and value.is_integer() else value


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
