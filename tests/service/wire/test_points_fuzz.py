"""Bytes and queries from strangers as points: they are points, or refused."""

import json
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dsbrdf import InvalidArgumentError
from dsbrdf_service.wire.points import Points, from_query, npy_blocks, take_lists
from tests.support.points import npy
from tests.support.strategies import MODEL, arrays, examples


def check_points(blocks: Callable[[], Iterable[Points]]) -> None:
    """Points that are accepted have values, or are refused where the model looks at them."""
    with suppress(InvalidArgumentError):
        (points,) = blocks()
        values = points.values(MODEL)
        assert values.shape == (len(points), 3)
        assert np.isfinite(values).all()


@examples(10)
@given(st.one_of(arrays(), st.binary(max_size=100), st.binary(max_size=100).map(b"\x93NUMPY\1\0".__add__)))
def test_npy_bodies_are_points_or_refused(body: bytes) -> None:
    check_points(lambda: npy_blocks(body))


POINTS = npy([[10.0, 30.0], [0.0, 90.0]])


@examples(3)
@given(st.lists(st.tuples(st.integers(0, len(POINTS)), st.binary(max_size=8)), min_size=1, max_size=3))
def test_damaged_npy_bodies_are_points_or_refused(changes: list[tuple[int, bytes]]) -> None:
    body = bytearray(POINTS)
    for place, content in changes:
        body[place : place + len(content)] = content
    check_points(lambda: npy_blocks(bytes(body)))


names = st.one_of(
    st.sampled_from(["theta_half_deg", "theta_diff_deg", "phi_diff_deg", "omega_in", "omega_out"]), st.text(max_size=5)
)

texts = st.one_of(
    st.text(max_size=12),
    st.floats().map(str),
    st.sampled_from(["0,0,1", "1,0,0", "0,0,-1", "nan,0,1", "1_0", "٣", " 1 ", "1e-400", "0x1", "0,0,1,", "1e308,0,0"]),
)


@examples(5)
@given(st.lists(st.tuples(names, texts), max_size=4))
def test_queries_are_points_or_refused(items: list[tuple[str, str]]) -> None:
    check_points(lambda: [from_query(items)])


def test_lists_of_numbers_are_taken_from_a_document_as_json_reads_them() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 3, 2000, 5000):
        angles: dict[str, Any] = {name: rng.normal(size=n).tolist() for name in ("first", "second")}
        for indent in (None, 1):
            rest, taken = take_lists(json.dumps(angles, indent=indent).encode(), 1)
            assert json.loads(rest) == {"first": [], "second": []}
            assert {name: numbers.tolist() for name, numbers in taken.items()} == angles
        vectors = {"omega": rng.normal(size=(n, 3)).tolist()}
        rest, taken = take_lists(json.dumps(vectors).encode(), 2)
        assert (json.loads(rest), taken["omega"].tolist()) == ({"omega": []}, vectors["omega"])


@pytest.mark.parametrize(
    "wrong", ["", ",", "true", '"1"', "[1]", "1e999", "01", "1 2", "null", "9" * 400, "NaN", "{}", "}", "]"]
)
def test_document_with_anything_else_stays_whole(wrong: str) -> None:
    for before in ("", "1," * 20_000):  # in the first piece, or in the last
        for after in ("", ",1"):
            body = f'{{"angles": [{before}{wrong}{after}]}}'.encode()
            assert take_lists(body, 1) == take_lists(body, 2) == (body, {})
