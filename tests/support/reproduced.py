"""Results that stay: a figure published with a release is obtained again from the same measurement.

A test hands over what the library has found. It is compared with what ``tests/reproduced`` has stored under that name;
with DSBRDF_STORE_RESULTS=1 it is stored instead, which a change of results needs:

    DSBRDF_STORE_RESULTS=1 python -m pytest -n 0 FILE_OF_THE_TEST
"""

import json
import os
import re
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf import FitResult

FOLDER = Path(__file__).parents[1] / "reproduced"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?:\s?[%°])?")


def digest(values: ArrayLike) -> dict[str, Any]:
    """Sums over an array, with weights that tell its elements apart, stand for all of its numbers."""
    array = np.nan_to_num(np.asarray(values, float))
    waves = np.cos(np.outer([0.0, 0.7, 2.9], np.arange(array.size)))
    return {"shape": "x".join(map(str, array.shape)), "means": (waves @ array.ravel() / max(array.size, 1)).tolist()}


def of_fit(result: FitResult) -> dict[str, Any]:
    """What a fit has found, without what depends on the machine, and some values of its model."""
    report = result.report.to_dict()
    kept = ("findings_of_fit", "by_channel", "by_theta_diff", "search", "selection", "left_out")
    theta_half, theta_diff = np.radians([[0.0], [2.0], [10.0], [40.0], [70.0]]), np.radians([0.0, 30.0, 65.0])
    values = result.model.evaluate(theta_half, theta_diff, 0.4)
    return {name: report[name] for name in ("metrics", "n_numbers", "directional_albedo", *kept) if report[name]} | {
        "values": values.reshape(5, 9).tolist()
    }


def assert_reproduced(place: str, found: object, tolerance: float = 1e-6) -> None:
    """Assert that a result equals the stored one: words exactly, numbers within a tolerance, relative to their list.

    A number in a sentence may also differ by one in its last digit, but a whole number without % and ° may not differ.
    """
    name, _, key = place.partition("/")
    path = FOLDER / f"{name}.json"
    results = json.loads(path.read_text()) if path.exists() else {}
    plain = json.loads(json.dumps(found, allow_nan=False, default=lambda array: array.tolist()))
    if os.environ.get("DSBRDF_STORE_RESULTS"):
        path.parent.mkdir(exist_ok=True)
        results[key] = _rounded(plain)
        text = json.dumps(dict(sorted(results.items())), indent=1, ensure_ascii=False)
        for _ in range(2):  # Lists and objects that fit in a line stand in one.
            text = re.sub(r"[\[{][^\[\]{}]*(?:\[[^\[\]{}\n]*\][^\[\]{}]*)*[\]}]", _in_a_line, text)
        path.write_text(text + "\n")
        return
    assert key in results, f"{path} lacks {key!r}; {__doc__}"
    changes = "\n".join(_changes(results[key], plain, tolerance, key))
    assert not changes, f"Results have changed:\n{changes}\nIf that is meant, store them anew: {__doc__}"


def _in_a_line(found: re.Match[str]) -> str:
    line = re.sub(r"\s+", " ", found[0]).replace("[ ", "[").replace(" ]", "]").replace("{ ", "{").replace(" }", "}")
    return line if len(line) <= 110 or '"' not in line else found[0]


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.7g}") if isinstance(value, float) else value


def _changes(stored: Any, found: Any, tolerance: float, place: str) -> Iterator[str]:
    if isinstance(stored, dict) and isinstance(found, dict) and stored.keys() == found.keys():
        for name in stored:
            yield from _changes(stored[name], found[name], tolerance, f"{place}: {name}")
    elif isinstance(stored, list) and isinstance(found, list) and len(stored) == len(found):
        if not {type(one) for one in (*stored, *found)} <= {int, float}:
            for number, pair in enumerate(zip(stored, found, strict=True)):
                yield from _changes(*pair, tolerance, f"{place}: {number}")
        elif stored and np.abs(np.subtract(stored, found)).max() > tolerance * np.abs(stored).max():
            yield f"{place}: {stored} -> {found}"
    elif isinstance(stored, float) and isinstance(found, float | int):
        if abs(found - stored) > tolerance * abs(stored):
            yield f"{place}: {stored} -> {found}"
    elif isinstance(stored, str) and isinstance(found, str):
        if not _is_same_text(stored, found, tolerance):
            yield f"{place}: {stored!r} -> {found!r}"
    elif stored != found or type(stored) is not type(found):
        yield f"{place}: {stored} -> {found}"


def _is_same_text(stored: str, found: str, tolerance: float) -> bool:
    words = [re.sub(r" +", " ", NUMBER.sub("#", text)) for text in (stored, found)]
    numbers = zip(*(NUMBER.findall(text) for text in (stored, found)), strict=False)
    return words[0] == words[1] and all(_is_same_number(first, second, tolerance) for first, second in numbers)


def _is_same_number(stored: str, found: str, tolerance: float) -> bool:
    if "." not in stored + found and stored[-1].isdigit():
        return stored == found
    pair = [Decimal(text.rstrip("%° ")) for text in (stored, found)]
    last_digit = min(Decimal((0, (1,), int(one.as_tuple().exponent))) for one in pair)
    return abs(pair[0] - pair[1]) <= max(last_digit, Decimal(tolerance) * abs(pair[0]))
