"""Fit options on the wire: those of the library, with angles in degrees and names that end in ``_deg``.

The library checks them. The Python client uses this module too: it needs neither FastAPI nor pydantic.
"""

import json
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.global_method import KNOTS
from dsbrdf.fitting.options import FitOptions

_ANGLES = ("horizon_cutoff", "knots")  # radians in the library, degrees on the wire
_NUMBERS = (*_ANGLES, "mask")  # the library checks the types of the others
_DECIMALS = 9  # of a degree: takes off what the conversion to radians and back has added
WIRE_NAMES = {field.name: f"{field.name}_deg" if field.name in _ANGLES else field.name for field in fields(FitOptions)}
"""Name of an option in the library -> its name on the wire."""
_WORDS = {"none": None, "null": None, "true": True, "false": False}
_NUMBER = re.compile(r"-?(0|[1-9][0-9]{0,17})(\.[0-9]{1,30})?(e[+-]?[0-9]{1,4})?")


def to_wire(options: FitOptions) -> dict[str, Any]:
    """Return the options under their wire names, in JSON's types; equal options give equal dicts."""
    return {wire: _to_degrees(name, getattr(options, name)) for name, wire in WIRE_NAMES.items()}


def from_wire(values: Mapping[str, Any]) -> FitOptions:
    """Return the options for JSON values under wire names; what is not given is the default.

    Raises InvalidArgumentError if a name is unknown, or a value is of a wrong type or out of range.
    """
    unknown = [name for name in values if name not in WIRE_NAMES.values()]
    if unknown:
        names = ", ".join(repr(name[:60]) for name in unknown[:5])
        plural = "options" if len(unknown) > 1 else "option"
        raise InvalidArgumentError(f"Unknown {plural} {names}; known options are {', '.join(WIRE_NAMES.values())}.")
    given = {name: values[wire] for name, wire in WIRE_NAMES.items() if wire in values}
    return FitOptions(**{name: _from_json(name, value) for name, value in given.items()})


def from_query(items: Iterable[tuple[str, str]]) -> FitOptions:
    """Return the options for the parameters of a query; commas separate the items of a list, ``none`` means null.

    Raises InvalidArgumentError as `from_wire`.
    """

    def value(text: str) -> Any:
        return [_from_text(part) for part in text.split(",")] if "," in text else _from_text(text)

    return from_wire({name: value(text) for name, text in items})


def canonical(options: FitOptions) -> dict[str, Any]:
    """Return the wire form with the method's own choices filled in: options that give the same fit become equal."""
    paper = options.method == "paper"
    mask = options.mask if options.mask is not None else 1.0 if paper else 0.0
    horizon = options.horizon_cutoff is not None and options.horizon_cutoff >= np.pi / 2
    usual = options.knots is not None and _to_degrees("knots", options.knots) == _USUAL_KNOTS[options.variation]
    filled = replace(
        options,
        ring_lobes=0 if paper else options.ring_lobes,
        knots=None if usual else options.knots,
        horizon_cutoff=None if horizon else options.horizon_cutoff,
        mask=float(mask),
        weighting=options.resolved_weighting,  # type: ignore[arg-type]  # one of the words that it may be
        em_iterations=options.em_iterations if paper else FitOptions.em_iterations,
    )
    return to_wire(filled)


def _to_degrees(name: str, value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_to_degrees(name, item) for item in value]
    if name in _ANGLES and isinstance(value, (int, float)):
        return round(float(np.degrees(value)), _DECIMALS)
    return value


def _from_json(name: str, value: Any) -> Any:
    """Return the library's value for a JSON value; the library checks all of it but what is a number."""
    if name in _NUMBERS and value is not None:
        numbers = value if name == "knots" and isinstance(value, list) else [value]
        if not all(type(number) in (int, float) and abs(number) <= sys.float_info.max for number in numbers):
            expected = "a list of numbers" if name == "knots" else "a number"
            raise InvalidArgumentError(f"{WIRE_NAMES[name]} must be {expected} or none, not {str(value)[:60]!r}.")
        if name == "mask":
            return _whole(value)
        radians = tuple(float(np.radians(round(float(number), _DECIMALS))) for number in numbers)
        return radians if name == "knots" else radians[0]
    return _whole(value) if isinstance(value, (int, float, type(None))) else str(value)[:60]


def _from_text(text: str) -> Any:
    """Return the JSON value that a text stands for; the text itself if it stands for none."""
    word = text.strip().lower()
    if word in _WORDS:
        return _WORDS[word]
    return json.loads(word) if _NUMBER.fullmatch(word) else text


def _whole(value: Any) -> Any:
    """Return a whole number as an int, however it is written."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


_USUAL_KNOTS = {name: _to_degrees("knots", knots[0].tolist()) for name, knots in KNOTS.items()}
DEFAULTS = to_wire(FitOptions())
