"""Convert JSON values to dataclasses by type annotations; a ModelFormatError names an invalid value by its path."""

import sys
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import cache
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from dsbrdf.errors import ModelFormatError


def typed(kind: Any, value: Any, place: str) -> Any:
    """Convert a JSON value to the type of an annotation: a mapping to a dataclass, a list to a tuple."""
    origin, arguments = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        hints = _hints(kind)
        check_keys(place, value, tuple(hints))
        return kind(**{name: typed(hint, value[name], f"{place}.{name}") for name, hint in hints.items()})
    if origin in (Union, UnionType):
        return typed(next((choice for choice in arguments if _fits(choice, value)), arguments[0]), value, place)
    if not _fits(kind, value):
        raise ModelFormatError(f"The stored {place} is of the wrong kind, {type(value).__name__}.")
    if origin is tuple:
        kinds = arguments[:1] * len(value) if arguments[-1] is ... else arguments
        if len(kinds) != len(value):
            raise ModelFormatError(f"The stored {place} has {len(value)} values, not {len(kinds)}.")
        return tuple(typed(item, part, place) for item, part in zip(kinds, value, strict=True))
    if origin is dict:
        return {name: typed(arguments[1], part, f"{place}.{name}") for name, part in value.items()}
    return value


def _fits(kind: Any, value: Any) -> bool:
    """Return whether a JSON value can be converted to a type; the elements of a list or mapping are not checked."""
    origin = get_origin(kind)
    if is_dataclass(kind) and isinstance(kind, type):
        return isinstance(value, Mapping) and set(value) == set(_hints(kind))
    if origin is Literal:
        return isinstance(value, str) and value in get_args(kind)
    if origin is tuple:
        return isinstance(value, list)
    if origin is dict:
        return isinstance(value, dict)
    if kind is float:  # JSON may write 1 for 1.0, and a number with too large an exponent is read as infinity.
        return type(value) in (int, float) and abs(value) <= sys.float_info.max
    return type(value) is kind


_hints = cache(get_type_hints)


def check_keys(what: str, content: Any, wanted: tuple[str, ...]) -> None:
    """Raise ModelFormatError unless a JSON value is a mapping with exactly the wanted keys."""
    if not isinstance(content, Mapping):
        raise ModelFormatError(f"The stored {what} must be a mapping of names to values.")
    missing = [key for key in wanted if key not in content]
    if missing:
        raise ModelFormatError(f"The stored {what} lacks the key {missing[0]!r}.")
    unknown = [key for key in content if key not in wanted]
    if unknown:
        raise ModelFormatError(f"The stored {what} has the unknown key {unknown[0]!r}.")
