"""Fit options on the wire: those of the library, with angles in degrees and names that end in ``_deg``.

`OPTIONS_SCHEMA` declares the types, for the OpenAPI document and for the checks here; the ranges are the library's.
The Python client uses this module too: it needs neither FastAPI nor pydantic.
"""

import json
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from dsbrdf.data.grid import THETA_DIFF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.global_method import KNOTS
from dsbrdf.fitting.options import (
    MAX_EM_ITERATIONS,
    MAX_LOBES,
    MAX_MASK,
    MAX_RING_LOBES,
    METHODS,
    VARIATIONS,
    WEIGHTINGS,
    FitOptions,
)
from dsbrdf.model.lobes import FAMILIES

_ANGLES = ("horizon_cutoff", "knots")  # radians in the library, degrees on the wire
_NUMBERS = (*_ANGLES, "mask")  # the library checks the types of the others
_DECIMALS = 9  # of a degree: takes off what the conversion to radians and back has added
_WIRE_NAMES = {field.name: f"{field.name}_deg" if field.name in _ANGLES else field.name for field in fields(FitOptions)}
_WORDS = {"none": None, "null": None, "true": True, "false": False}
_NUMBER = re.compile(r"-?(0|[1-9][0-9]{0,17})(\.[0-9]{1,30})?(e[+-]?[0-9]{1,4})?")


def to_wire(options: FitOptions) -> dict[str, Any]:
    """Return the options under their wire names, in JSON's types; equal options give equal dicts."""
    return {wire: _to_degrees(name, getattr(options, name)) for name, wire in _WIRE_NAMES.items()}


def from_wire(values: Mapping[str, Any]) -> FitOptions:
    """Return the options for JSON values under wire names; what is not given is the default.

    Raises InvalidArgumentError if a name is unknown, or a value is of a wrong type or out of range.
    """
    unknown = [name for name in values if name not in _PROPERTIES]
    if unknown:
        names = ", ".join(repr(name[:60]) for name in unknown[:5])
        plural = "options" if len(unknown) > 1 else "option"
        raise InvalidArgumentError(f"Unknown {plural} {names}; known options are {', '.join(_PROPERTIES)}.")
    given = {name: values[wire] for name, wire in _WIRE_NAMES.items() if wire in values}
    return FitOptions(**{name: _from_json(name, value) for name, value in given.items()})


def from_query(items: Iterable[tuple[str, str]]) -> FitOptions:
    """Return the options for the parameters of a query; commas separate the items of a list, ``none`` means null.

    Raises InvalidArgumentError: as `from_wire`, or if an option is given twice.
    """
    values: dict[str, Any] = {}
    for name, text in items:
        if name in values:
            raise InvalidArgumentError(f"The option {name[:60]!r} is given more than once; give it once.")
        values[name] = [_from_text(part) for part in text.split(",")] if "," in text else _from_text(text)
    return from_wire(values)


def canonical(options: FitOptions) -> dict[str, Any]:
    """Return the wire form of the options, the method's own choices filled in; those that give one fit become equal."""
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
            raise InvalidArgumentError(f"{_WIRE_NAMES[name]} must be {expected} or none, not {str(value)[:60]!r}.")
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
_AUTO = {"type": "string", "enum": ["auto"]}
_NONE = {"type": "null"}
_PROPERTIES: dict[str, dict[str, Any]] = {
    "n_lobes": {"anyOf": [{"type": "integer", "minimum": 1, "maximum": MAX_LOBES}, _AUTO]},
    "method": {"type": "string", "enum": [*METHODS]},
    "ring_lobes": {"anyOf": [{"type": "integer", "minimum": 0, "maximum": MAX_RING_LOBES}, _AUTO]},
    "lobe": {"type": "string", "enum": [*FAMILIES]},
    "knots_deg": {
        "anyOf": [
            {
                "type": "array",
                "items": {"type": "integer", "minimum": 0, "maximum": THETA_DIFF.size - 1},
                "minItems": 2,
                "maxItems": THETA_DIFF.size,
                "uniqueItems": True,
                "description": "Increasing, whole degrees; null takes 8, or 3 where the variation is parametric.",
            },
            _NONE,
        ]
    },
    "variation": {"type": "string", "enum": [*VARIATIONS]},
    "horizon_cutoff_deg": {"anyOf": [{"type": "number", "exclusiveMinimum": 0, "maximum": 90}, _NONE]},
    "mask": {"anyOf": [{"type": "number", "minimum": 0, "maximum": MAX_MASK}, _NONE]},
    "weighting": {"anyOf": [{"type": "string", "enum": [*WEIGHTINGS]}, _NONE]},
    "robust": {"type": "boolean"},
    "em_iterations": {"type": "integer", "minimum": 1, "maximum": MAX_EM_ITERATIONS},
}
_OF_THE_PAPER = {
    "lobe": {"const": "hemi_epd"},
    "variation": {"const": "full"},
    "weighting": {"not": {"const": "balanced"}},
}
OPTIONS_SCHEMA: dict[str, Any] = {
    "type": "object",
    "title": "FitOptions",
    "description": "Options of a fit; what is not given is the default.",
    "additionalProperties": False,
    "properties": {name: {**schema, "default": DEFAULTS[name]} for name, schema in _PROPERTIES.items()},
    # Algorithm 1 has neither ring lobes nor knots of its own choice, and the paper's lobe and weighting.
    "if": {"properties": {"method": {"const": "paper"}}, "required": ["method"]},
    "then": {"properties": {"ring_lobes": {"enum": ["auto", 0]}, "knots_deg": {"type": "null"}, **_OF_THE_PAPER}},
}
"""JSON schema of the options; a test compares its ranges with those that the library checks."""
