"""Bytes and queries from strangers as points: they are points, or refused."""

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dsbrdf import InvalidArgumentError
from dsbrdf_service.wire.points import Points, from_npy, from_query
from tests.support.points import npy
from tests.support.strategies import MODEL, arrays, examples


def check_points(read: Callable[[], Points]) -> None:
    """Points that are accepted have values, or are refused where the model looks at them."""
    with suppress(InvalidArgumentError):
        points = read()
        values = points.values(MODEL)
        assert values.shape == (len(points), 3)
        assert np.isfinite(values).all()


@examples(10)
@given(st.one_of(arrays(), st.binary(max_size=100), st.binary(max_size=100).map(b"\x93NUMPY\1\0".__add__)))
def test_npy_bodies_are_points_or_refused(body: bytes) -> None:
    check_points(lambda: from_npy(body))


POINTS = npy([[10.0, 30.0], [0.0, 90.0]])


@examples(3)
@given(st.lists(st.tuples(st.integers(0, len(POINTS)), st.binary(max_size=8)), min_size=1, max_size=3))
def test_damaged_npy_bodies_are_points_or_refused(changes: list[tuple[int, bytes]]) -> None:
    body = bytearray(POINTS)
    for place, content in changes:
        body[place : place + len(content)] = content
    check_points(lambda: from_npy(bytes(body)))


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
    check_points(lambda: from_query(items))
