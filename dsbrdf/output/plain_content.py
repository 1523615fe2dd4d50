"""Models and reports <-> dicts, lists, texts and numbers, as JSON has them.

The keys are the names of the attributes. Everything that is read is checked: damaged content raises a
`ModelFormatError`.
"""

import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import InvalidArgumentError, ModelFormatError
from dsbrdf.fitting.report import FitReport
from dsbrdf.model.dsbrdf import DSBRDF, TEXTS

ARRAYS = tuple(field.name for field in fields(DSBRDF) if field.name not in TEXTS)
"""Attributes of a model that are arrays."""


def model_to_dict(model: DSBRDF) -> dict[str, Any]:
    """Return a model as nested lists of numbers, keyed by the names of its attributes; angles in radians."""
    arrays = {name: getattr(model, name).tolist() for name in ARRAYS}
    return arrays | {name: getattr(model, name) for name in TEXTS}


def model_from_dict(content: Mapping[str, Any]) -> DSBRDF:
    """Return the model of nested lists or arrays; the inverse of `model_to_dict`.

    Raises ModelFormatError if a key is missing or unknown, or a value has the wrong shape, is not finite or out of
    range.
    """
    _check_keys("model", content, (*ARRAYS, *TEXTS))
    parameters: dict[str, Any] = {name: _numbers(name, content[name]) for name in ARRAYS}
    for name in TEXTS:
        if not isinstance(content[name], str):
            raise ModelFormatError(f"The {name} in the stored model is not a text.")
        parameters[name] = content[name]
    try:
        return DSBRDF(**parameters)
    except InvalidArgumentError as error:
        raise ModelFormatError(f"The stored model is not valid: {error}") from None


def report_from_dict(content: Mapping[str, Any]) -> FitReport:
    """Return the report of dicts and lists; the inverse of `FitReport.to_dict`.

    Raises ModelFormatError if a key is missing or unknown, a value is of the wrong kind, or the options are not valid.
    """
    try:
        report: FitReport = _typed(FitReport, content, "report")
    except InvalidArgumentError as error:
        raise ModelFormatError(f"The options in the stored report are not valid: {error}") from None
    return report


def _typed(kind: Any, value: Any, place: str) -> Any:
    """Return a JSON value as what the annotation ``kind`` says: a mapping as a dataclass, a list as a tuple."""
    origin, arguments = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        hints = _hints(kind)
        _check_keys(place, value, tuple(hints))
        return kind(**{name: _typed(hint, value[name], f"{place}.{name}") for name, hint in hints.items()})
    if origin in (Union, UnionType):
        return _typed(next((choice for choice in arguments if _fits(choice, value)), arguments[0]), value, place)
    if not _fits(kind, value):
        raise ModelFormatError(f"The stored {place} is of the wrong kind, {type(value).__name__}.")
    if origin is tuple:
        kinds = arguments[:1] * len(value) if arguments[-1] is ... else arguments
        if len(kinds) != len(value):
            raise ModelFormatError(f"The stored {place} has {len(value)} values, not {len(kinds)}.")
        return tuple(_typed(item, part, place) for item, part in zip(kinds, value, strict=True))
    if origin is dict:
        return {name: _typed(arguments[1], part, f"{place}.{name}") for name, part in value.items()}
    return value


def _fits(kind: Any, value: Any) -> bool:
    """Whether a JSON value can be of a kind, what it contains apart."""
    origin = get_origin(kind)
    if origin is Literal:
        return isinstance(value, str) and value in get_args(kind)
    if origin is tuple:
        return isinstance(value, list)
    if origin is dict:
        return isinstance(value, dict)
    if kind is float:  # JSON does not tell 1 from 1.0, and an exponent that is too large reads as infinity
        return type(value) in (int, float) and abs(value) <= sys.float_info.max
    return type(value) is kind


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _numbers(name: str, value: Any) -> Array:
    try:
        array = np.asarray(value)
    except ValueError:
        raise ModelFormatError(f"The stored model's {name} is not a regular array.") from None
    if array.dtype.kind not in "fi":
        raise ModelFormatError(f"The stored model's {name} is not an array of real numbers.")
    return array.astype(np.float64)


def _check_keys(what: str, content: Any, wanted: tuple[str, ...]) -> None:
    if not isinstance(content, Mapping):
        raise ModelFormatError(f"The stored {what} must be a mapping of names to values.")
    missing = [key for key in wanted if key not in content]
    if missing:
        raise ModelFormatError(f"The stored {what} lacks the key {missing[0]!r}.")
    unknown = [key for key in content if key not in wanted]
    if unknown:
        raise ModelFormatError(f"The stored {what} has the unknown key {unknown[0]!r}.")
