"""What comes over the wire: ranges of options as the library checks them, and faults in plain words."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from openapi_schema_validator import OAS31Validator

import dsbrdf
from dsbrdf import FitOptions, InvalidArgumentError
from dsbrdf_service.api.fields import OPTIONS_SCHEMA
from dsbrdf_service.storage.store import fit_identity
from dsbrdf_service.wire import DEFAULTS, canonical, from_query, from_wire, to_wire
from tests.support.server import Server, assert_problem

PROPERTIES: dict[str, dict[str, Any]] = OPTIONS_SCHEMA["properties"]


def values_at_edges(schema: dict[str, Any]) -> Iterator[Any]:
    """Values at the edges of what the document allows for an option, on both sides, and of other types."""
    yield from (None, True, False, 1, "other")
    for branch in schema.get("anyOf", [schema]):
        if branch["type"] in ("integer", "number"):
            least = branch.get("exclusiveMinimum", branch.get("minimum", -1.0))
            for bound in (least, branch.get("maximum", 1e30)):
                yield from (bound, bound - 1, bound + 1, bound + 0.5, bound - 1e-8, bound + 1e-8)
        elif branch["type"] == "array" and "minItems" not in branch:
            yield from ([0], [-999, 1e30], ["theta_in=AOI"], ["AOI"], ["=AOI"], ["value= "], [None])
        elif branch["type"] == "array":
            low, high = branch["items"]["minimum"], branch["items"]["maximum"]
            yield from ([low, high], [*range(branch["maxItems"])])
            yield from ([], [high], [low, high + 1], [low - 1, high], [low, low])
        elif branch["type"] == "string":
            for word in branch.get("enum", [branch.get("const")]):
                yield from (word, f"{word}x")


@pytest.mark.parametrize("name", PROPERTIES)
def test_option_ranges_equal_those_of_the_library(name: str) -> None:
    valid = OAS31Validator(PROPERTIES[name]).is_valid
    for value in values_at_edges(PROPERTIES[name]):
        text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
        assert accepted(from_wire, {name: value}) == valid(value), value
        assert accepted(from_query, [(name, text)]) == valid(value), value
    for value in ("3", "true", "none", [3], [0, "30"], [[0, 30]], {"a": 1}):
        assert accepted(from_wire, {name: value}) == valid(value), value
    assert not any(accepted(from_wire, {name: value}) for value in (math.nan, math.inf))
    assert PROPERTIES[name]["description"].endswith(".")


def accepted(parse: Callable[[Any], FitOptions], values: object) -> bool:
    try:
        parse(values)
    except InvalidArgumentError:
        return False
    return True


def test_whole_number_is_accepted_as_integer() -> None:
    assert from_wire({"n_lobes": 3.0}).n_lobes == 3
    found = from_query([("n_lobes", "3.0"), ("mask", "1e-1"), ("robust", "TRUE")])
    assert found == FitOptions(n_lobes=3, mask=0.1, robust=True)


@pytest.mark.parametrize(
    ("name", "text"),
    [("n_lobes", "1_0"), ("n_lobes", "٣"), ("robust", "1"), ("mask", "0x1"), ("mask", "nan"), ("mask", ""),
     ("n_lobes", "9" * 5000), ("n_lobes", "[" * 8000)],
)  # fmt: skip
def test_query_options_in_other_notations_are_refused(name: str, text: str) -> None:
    with pytest.raises(InvalidArgumentError, match=name):
        from_query([(name, text)])


def test_option_that_cannot_be_stored_is_refused(server: Server, stored: str) -> None:
    # It is above 0 until it is rounded to the digits that are kept.
    assert_problem(server.submit(stored, horizon_cutoff_deg=1e-11), 422, "invalid-argument")


def test_options_survive_the_wire_format() -> None:
    for options in (
        FitOptions(horizon_cutoff_deg=None, n_lobes=8, robust=True, lobe="student", weighting="balanced"),
        FitOptions(method="global", knots_deg=(0, 17, 60, 80), horizon_cutoff_deg=71.3),
    ):
        wire = to_wire(options)
        assert to_wire(from_wire(wire)) == wire
    assert from_wire({}) == from_wire(DEFAULTS) == FitOptions()
    assert from_query([("horizon_cutoff_deg", "None")]).horizon_cutoff_deg is None
    assert from_query([("knots_deg", "0,30,60.0")]).knots_deg == (0, 30, 60)
    with pytest.raises(InvalidArgumentError, match="increasing"):
        from_query([("knots_deg", "30,20")])


def identity(options: FitOptions, measurement: str = "a" * 64) -> str:
    return fit_identity(measurement, canonical(options))


@pytest.mark.parametrize(
    ("options", "same"),
    [
        ({}, {"em_iterations": 7}),
        ({}, {"mask": 0.0}),
        ({}, {"horizon_cutoff_deg": 80 + 1e-12}),
        ({}, {"weighting": "balanced"}),
        ({"horizon_cutoff_deg": None}, {"horizon_cutoff_deg": 90}),
        ({}, {"knots_deg": (0, 30, 55, 68, 75, 81, 89)}),
        ({"variation": "parametric"}, {"variation": "parametric", "knots_deg": (0, 70, 89)}),
        ({"method": "paper"}, {"method": "paper", "mask": 1}),
        ({"method": "paper"}, {"method": "paper", "ring_lobes": 0, "weighting": "plain"}),
    ],
)
def test_options_that_change_nothing_leave_the_identity(options: dict[str, Any], same: dict[str, Any]) -> None:
    first, second = FitOptions(**options), FitOptions(**same)
    assert canonical(first) == canonical(second) == canonical(from_wire(canonical(first)))
    assert identity(first) == identity(second)


def test_every_other_option_measurement_and_algorithm_changes_the_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    of_global: dict[str, Any] = {"n_lobes": 3, "ring_lobes": 0, "lobe": "student", "knots_deg": (0, 60), "mask": 1.0}
    of_global |= {"variation": "parametric", "horizon_cutoff_deg": 75, "weighting": "plain", "robust": True}
    of_paper: dict[str, Any] = {"em_iterations": 7, "mask": 0.0, "n_lobes": 2, "weighting": "log"}
    changed: list[dict[str, Any]] = [{}, *({name: value} for name, value in of_global.items())]
    changed += [{"method": "paper"}, *({"method": "paper", name: value} for name, value in of_paper.items())]
    identities = {identity(FitOptions(**options)) for options in changed} | {identity(FitOptions(), "b" * 64)}
    monkeypatch.setattr(dsbrdf, "ALGORITHM_VERSION", "another")
    assert len(identities | {identity(FitOptions())}) == len(changed) + 2
