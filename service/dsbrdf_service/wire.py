"""Convert options to JSON types and back, and check names; the Python client and the service share this module.

The library checks the fields of `FitOptions` and `TableOptions`. The module needs neither FastAPI nor pydantic, which
the client lacks.
"""

import json
import re
from collections.abc import Container, Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.global_method import KNOTS
from dsbrdf.fitting.options import FitOptions
from dsbrdf.samples.table_options import AS_WRITTEN, TableOptions

MAX_NAME_LENGTH = 100
_NAMES = [field.name for field in fields(FitOptions)]


def check_name(text: str) -> str:
    """Return a name; raise InvalidArgumentError if it cannot be the name of a file on any system."""
    if (
        not 0 < len(text) <= MAX_NAME_LENGTH
        or not text.isprintable()
        or text.strip() != text
        or re.search(r"[/\\]", text)
    ):
        raise InvalidArgumentError(
            f"{text[:60]!r} is not a valid name: a name has 1 to {MAX_NAME_LENGTH} printable characters, no slash "
            "and no space at its ends."
        )
    return text


def to_wire(options: FitOptions | TableOptions) -> dict[str, Any]:
    """Return options in JSON types; equal options give equal dicts."""
    wire = {}
    for field in fields(options):
        value = getattr(options, field.name)
        wire[field.name] = list(value) if isinstance(value, tuple) else value
    return wire


def from_wire(values: Mapping[str, Any]) -> FitOptions:
    """Return the options for JSON values; missing options have their defaults.

    Raises InvalidArgumentError if a name is unknown, or a value is of a wrong type or out of range.
    """
    options: dict[str, Any] = {}
    for name, value in values.items():
        if name not in _NAMES:
            raise InvalidArgumentError(f"Unknown option {name[:60]!r}; known options are {', '.join(_NAMES)}.")
        is_whole = isinstance(value, float) and value.is_integer()  # JSON does not distinguish 3.0 from 3.
        options[name] = int(value) if is_whole else value
    return FitOptions(**options)


def from_query(items: Iterable[tuple[str, str]]) -> FitOptions:
    """Return the options among the parameters of a query: commas separate a list, ``none`` means null.

    Raises InvalidArgumentError if a name is unknown, or a value is of a wrong type or out of range.
    """
    chosen = _chosen(items, DEFAULTS)
    return from_wire(chosen) if chosen else _DEFAULT_OPTIONS


def table_from_query(items: Iterable[tuple[str, str]]) -> TableOptions:
    """Return the options of a table among the parameters of a query, in the notation of `from_query`."""
    chosen = _chosen(items, TABLE_DEFAULTS)
    return TableOptions(**chosen) if chosen else AS_WRITTEN


def _chosen(items: Iterable[tuple[str, str]], names: Container[str]) -> dict[str, Any]:
    """Return the parsed values of the parameters of a query that have one of the `names`."""
    chosen = {}
    for name, text in items:
        if name in names:
            chosen[name] = _from_text(text)
    return chosen


def canonical(options: FitOptions) -> dict[str, Any]:
    """Return options in JSON types, with the method's defaults filled in, so that equal fits have equal options."""
    wire, paper = to_wire(options), options.method == "paper"
    if wire["knots_deg"] == _USUAL_KNOTS[options.variation]:
        wire["knots_deg"] = "auto"
    if wire["horizon_cutoff_deg"] == 90.0:
        wire["horizon_cutoff_deg"] = None
    wire |= {"mask": options.resolved_mask, "weighting": options.resolved_weighting}
    return wire | ({"ring_lobes": 0} if paper else {"em_iterations": DEFAULTS["em_iterations"]})


def _from_text(text: str) -> Any:
    """Parse a text as one or several JSON values; if that fails, split it at commas."""
    try:
        values = json.loads(f"[{'null' if text.lower() == 'none' else text.lower()}]")
    except (ValueError, RecursionError):
        values = text.split(",")
    return values[0] if len(values) == 1 else values


_USUAL_KNOTS = {name: np.rint(np.degrees(knots[0])).astype(int).tolist() for name, knots in KNOTS.items()}
_DEFAULT_OPTIONS = FitOptions()
DEFAULTS = to_wire(_DEFAULT_OPTIONS)
TABLE_DEFAULTS = to_wire(AS_WRITTEN)
