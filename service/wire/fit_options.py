"""Fit options on the wire: those of the library, with angles in degrees and names that end in ``_deg``.

Names, types and defaults are taken from `dsbrdf.FitOptions`, so that they cannot drift apart.
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_type_hints

import numpy as np

from dsbrdf import FitOptions

_ANGLES = ("horizon_cutoff", "knots")  # radians in the library, degrees on the wire
_DECIMALS = 9  # of a degree: takes off what the conversion to radians and back has added
_WIRE_NAMES = {field.name: f"{field.name}_deg" if field.name in _ANGLES else field.name for field in fields(FitOptions)}
WIRE_TYPES: dict[str, Any] = {_WIRE_NAMES[name]: hint for name, hint in get_type_hints(FitOptions).items()}


def to_wire(options: FitOptions) -> dict[str, Any]:
    """Return the options under their wire names, in JSON's types; equal options give equal dicts."""
    return {wire: _to_degrees(name, getattr(options, name)) for name, wire in _WIRE_NAMES.items()}


def from_wire(values: Mapping[str, Any]) -> FitOptions:
    """Return the options for values under wire names and of the right types; what is not given keeps its default.

    Raises
    ------
    InvalidArgumentError
        If a value is out of range.
    """
    library = {name: _to_radians(name, values[wire]) for name, wire in _WIRE_NAMES.items() if wire in values}
    return FitOptions(**library)


def _to_degrees(name: str, value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_to_degrees(name, item) for item in value]
    if name in _ANGLES and isinstance(value, (int, float)):
        return round(float(np.degrees(value)), _DECIMALS)
    return value


def _to_radians(name: str, value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return tuple(_to_radians(name, item) for item in value)
    if name in _ANGLES and isinstance(value, (int, float)):
        return float(np.radians(value))
    return value


DEFAULTS = to_wire(FitOptions())
