"""Convert options to JSON types and back, and check names; the Python client and the service share this module.

The library checks the fields of `FitOptions` and `TableOptions`. The module needs neither FastAPI nor pydantic, which
the client lacks.
"""

import json
import re
from collections.abc import Container, Iterable, Mapping
from typing import Any

import numpy as np

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.global_method import KNOTS
from dsbrdf.fitting.options import FitOptions
from dsbrdf.samples.table_options import AS_WRITTEN, TableOptions

MAX_NAME_LENGTH = 100


def check_name(text: str) -> str:
    """Return a name; raise InvalidArgumentError if it cannot be the name of a file on any system."""
    is_usual = 0 < len(text) <= MAX_NAME_LENGTH and text.isprintable() and text.strip() == text
    if is_usual and not re.search(r"[/\\]", text):
        return text
    raise InvalidArgumentError(
        f"{text[:60]!r} is not a valid name: a name has 1 to {MAX_NAME_LENGTH} printable characters, no slash and no "
        "space at its ends."
    )


def to_wire(options: FitOptions | TableOptions) -> dict[str, Any]:
    """Return options in JSON types; equal options give equal dicts."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in vars(options).items()}


def from_wire(values: Mapping[str, Any]) -> FitOptions:
    """Return the options for JSON values; missing options have their defaults.

    Raises InvalidArgumentError if a name is unknown, or a value is of a wrong type or out of range.
    """
    options: dict[str, Any] = {}
    for name, value in values.items():
        if name not in DEFAULTS:
            raise InvalidArgumentError(f"Unknown option {name[:60]!r}; known options are {', '.join(DEFAULTS)}.")
        is_whole = isinstance(value, float) and value.is_integer()  # JSON does not distinguish 3.0 from 3.
        options[name] = int(value) if is_whole else value
    return FitOptions(**options)


def from_query(items: Iterable[tuple[str, str]]) -> FitOptions:
    """Return the options among the parameters of a query: commas separate a list, ``none`` means null.

    Raises InvalidArgumentError if a name is unknown, or a value is of a wrong type or out of range.
    """
    return from_wire(_chosen(items, DEFAULTS))


def table_from_query(items: Iterable[tuple[str, str]]) -> TableOptions:
    """Return the options of a table among the parameters of a query, in the notation of `from_query`."""
    return TableOptions(**_chosen(items, TABLE_DEFAULTS))


def _chosen(items: Iterable[tuple[str, str]], names: Container[str]) -> dict[str, Any]:
    return {name: _from_text(text) for name, text in items if name in names}


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
DEFAULTS = to_wire(FitOptions())
TABLE_DEFAULTS = to_wire(AS_WRITTEN)
