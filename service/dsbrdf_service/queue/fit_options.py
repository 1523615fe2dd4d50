"""Options on the wire: the fields of `FitOptions` and of `TableOptions` in JSON's types; the library checks them.

The Python client uses this module too: it needs neither FastAPI nor pydantic.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.global_method import KNOTS
from dsbrdf.fitting.options import FitOptions
from dsbrdf.samples.table_options import TableOptions

_NAMES = [field.name for field in fields(FitOptions)]


def to_wire(options: FitOptions | TableOptions) -> dict[str, Any]:
    """Return the options in JSON's types; equal options give equal dicts."""
    values = {field.name: getattr(options, field.name) for field in fields(options)}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def from_wire(values: Mapping[str, Any]) -> FitOptions:
    """Return the options for JSON values; what is not given is the default.

    Raises InvalidArgumentError if a name is unknown, or a value is of a wrong type or out of range.
    """
    unknown = [name for name in values if name not in _NAMES]
    if unknown:
        names = ", ".join(repr(name[:60]) for name in unknown[:5])
        plural = "options" if len(unknown) > 1 else "option"
        raise InvalidArgumentError(f"Unknown {plural} {names}; known options are {', '.join(_NAMES)}.")
    return FitOptions(**{name: _whole(value) for name, value in values.items()})


def from_query(items: Iterable[tuple[str, str]]) -> FitOptions:
    """Return the options for the parameters of a query; commas separate the items of a list, ``none`` means null.

    Raises InvalidArgumentError as `from_wire`.
    """
    return from_wire({name: _from_text(text) for name, text in items})


def table_from_query(items: Iterable[tuple[str, str]]) -> TableOptions:
    """Return the options of a table for the parameters of a query; notation and errors are those of `from_query`."""
    return TableOptions(**{name: _from_text(text) for name, text in items})


def canonical(options: FitOptions) -> dict[str, Any]:
    """Return the wire form with the method's own choices filled in: options that give the same fit become equal."""
    wire, paper = to_wire(options), options.method == "paper"
    if wire["knots_deg"] == _USUAL_KNOTS[options.variation]:
        wire["knots_deg"] = None
    if wire["horizon_cutoff_deg"] == 90.0:
        wire["horizon_cutoff_deg"] = None
    if wire["mask"] is None:
        wire["mask"] = 1.0 if paper else 0.0
    wire["weighting"] = options.resolved_weighting
    return wire | ({"ring_lobes": 0} if paper else {"em_iterations": DEFAULTS["em_iterations"]})


def _from_text(text: str) -> Any:
    """Return the JSON value, or the list of values, that a text stands for; its parts if it stands for none."""
    try:
        values = json.loads(f"[{'null' if text.lower() == 'none' else text.lower()}]")
    except (ValueError, RecursionError):
        values = text.split(",")
    return values[0] if len(values) == 1 else values


def _whole(value: Any) -> Any:
    """Return a whole number as an int, however it is written."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


_USUAL_KNOTS = {name: np.rint(np.degrees(knots[0])).astype(int).tolist() for name, knots in KNOTS.items()}
DEFAULTS = to_wire(FitOptions())
TABLE_DEFAULTS = to_wire(TableOptions())
