"""Bytes from strangers as MERL files: one verdict, whatever the pieces."""

import hashlib
import struct
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dsbrdf import MeasurementFormatError
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import encode_merl, parse_merl
from dsbrdf.data.merl_validation import FILE_SIZE, MerlChecker
from tests.support.merl_files import HEADER
from tests.support.strategies import SPECIAL, examples

# Measurements


def whole(data: bytes) -> str:
    """The sha256 and the number of valid nodes of a file read at once, or the sentence that refuses it."""
    try:
        measurement = parse_merl(data)
    except MeasurementFormatError as error:
        return str(error)
    return f"{measurement.sha256} {measurement.valid.sum()}"


def in_pieces(data: bytes, cuts: list[int]) -> str:
    """The same of a file that arrives in pieces."""
    checker = MerlChecker()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    try:
        for start, end in pairwise(edges):
            checker.update(data[start:end])
        valid = checker.finish()
    except MeasurementFormatError as error:
        return str(error)
    return f"{hashlib.sha256(data).hexdigest()} {valid.sum()}"


near_an_end = st.one_of(st.integers(0, 64), st.integers(FILE_SIZE - 64, FILE_SIZE + 64), st.integers(0, FILE_SIZE))

cut_places = st.lists(near_an_end, max_size=40)


@pytest.fixture(scope="module")
def file(plastic: Measurement) -> bytes:
    return encode_merl(plastic)


@st.composite
def damages(draw: st.DrawFn) -> list[tuple[int, bytes]]:
    """Places in a file and what to write there: bytes, or numbers with a meaning."""
    number = st.sampled_from(SPECIAL).map(lambda value: struct.pack("<d", value))
    run = st.tuples(number, st.sampled_from([1, 3, 70_000, 1_458_000])).map(lambda part: part[0] * part[1])
    value_place = st.integers(0, 3 * 90 * 90 * 180 - 1).map(lambda index: 12 + 8 * index)
    anywhere = st.tuples(near_an_end, st.binary(min_size=1, max_size=40))
    dimension = st.tuples(
        st.sampled_from([0, 4, 8]), st.integers(-(2**31), 2**31 - 1).map(lambda n: struct.pack("<i", n))
    )
    return draw(st.lists(st.one_of(st.tuples(value_place, run), anywhere, dimension), max_size=3))


@examples(0.3)
@given(damage=damages(), length=st.one_of(st.just(FILE_SIZE), near_an_end), cuts=cut_places)
def test_damaged_file_gets_one_result_in_any_chunks(
    file: bytes, damage: list[tuple[int, bytes]], length: int, cuts: list[int]
) -> None:
    changed = bytearray(file)
    for place, content in damage:
        changed[place : place + len(content)] = content
    data = bytes(changed[:length]).ljust(min(length, FILE_SIZE + 64), b"\0")
    assert in_pieces(data, cuts) == whole(data)


@examples(3)
@given(data=st.one_of(st.binary(max_size=80), st.binary(max_size=80).map(HEADER.__add__)), cuts=cut_places)
def test_short_byte_strings_are_refused(data: bytes, cuts: list[int]) -> None:
    with pytest.raises(MeasurementFormatError):
        parse_merl(data)
    assert in_pieces(data, cuts) == whole(data)
