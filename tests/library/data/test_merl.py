import hashlib
import os
import struct
import tracemalloc
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dsbrdf.data.grid import GRID_SHAPE, nodes_above_horizon
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import encode_merl, map_merl, parse_merl, read_merl, write_merl
from dsbrdf.data.merl_validation import FILE_SIZE, SCALE, MerlChecker
from dsbrdf.errors import MeasurementFormatError
from tests.support.merl_files import ABOVE, BELOW, HEADER, position, with_values
from tests.support.soak import repeats
from tests.support.strategies import SPECIAL, examples


def test_file_layout_is_that_of_the_merl_format(data: bytes, plastic: Measurement) -> None:
    assert data[:12] == HEADER
    assert len(data) == FILE_SIZE == 34_992_012
    for channel, node in ((0, (0, 0, 0)), (1, (3, 4, 5)), (2, (89, 89, 179))):
        assert plastic.stored[channel][node] == struct.unpack_from("<d", data, position(channel, node))[0]
    np.testing.assert_allclose(SCALE, [1 / 1500, 1.15 / 1500, 1.66 / 1500], rtol=1e-15)


def test_round_trip_is_bit_for_bit(data: bytes, plastic_file: Path, tmp_path: Path) -> None:
    measurement = read_merl(plastic_file)
    assert measurement.name == "plastic"
    assert measurement.sha256 == hashlib.sha256(data).hexdigest()
    assert encode_merl(measurement) == data
    copy = tmp_path / "copy.binary"
    write_merl(copy, measurement)
    assert copy.read_bytes() == data
    assert [path.name for path in tmp_path.iterdir()] == ["copy.binary"]


def test_unusual_valid_bit_patterns_survive(data: bytes) -> None:
    changes = {(0, ABOVE): -0.0, (1, ABOVE): 5e-324, (2, BELOW): -1e300, (0, (0, 0, 0)): -7.25}
    changed = with_values(data, changes)
    measurement = parse_merl(changed)
    assert encode_merl(measurement) == changed
    assert measurement.valid[ABOVE]
    assert not measurement.known(0)[0, 0, 0]


def test_immutable_bytes_are_shared_and_mutable_buffers_copied(data: bytes) -> None:
    assert np.shares_memory(parse_merl(data).stored, np.frombuffer(data, dtype=np.uint8))
    buffer = bytearray(data)
    measurement = parse_merl(buffer)
    buffer[position(0, ABOVE) : position(0, ABOVE) + 8] = bytes(8)
    assert measurement.stored[0][ABOVE] == parse_merl(data).stored[0][ABOVE]
    assert parse_merl(memoryview(data), "view").name == "view"


def test_failed_write_keeps_the_existing_file(tmp_path: Path) -> None:
    path = tmp_path / "kept.binary"
    path.write_bytes(b"before")
    with pytest.raises(MeasurementFormatError):
        write_merl(path, np.full((3, *GRID_SHAPE), np.nan))
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]
    old = tmp_path / "old"
    os.link(path, old)
    write_merl(path, np.ones((3, *GRID_SHAPE)))
    assert old.read_bytes() == b"before"  # another file takes the place, once it is whole
    with pytest.raises(FileNotFoundError):
        write_merl(tmp_path / "missing" / "a.binary", np.ones((3, *GRID_SHAPE)))


def test_written_files_have_ordinary_permissions(plastic: Measurement, tmp_path: Path) -> None:
    write_merl(tmp_path / "a.binary", plastic)
    (tmp_path / "b").write_bytes(b"")
    assert (tmp_path / "a.binary").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_reading_takes_little_more_memory_than_the_file(plastic_file: Path) -> None:
    nodes_above_horizon.cache_clear()  # made once per process, and part of the cost
    tracemalloc.start()
    try:
        read_merl(plastic_file)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < FILE_SIZE + 10_000_000


def test_reference_files_round_trip(reference_files: dict[str, Path]) -> None:
    for path in list(reference_files.values())[: repeats(1, 100)]:
        assert encode_merl(read_merl(path)) == path.read_bytes()


def test_valid_needs_a_channel_and_the_horizon(data: bytes) -> None:
    changes = {(0, (1, 1, 1)): -1.0, (1, (1, 1, 1)): -1e-300, (2, (1, 1, 1)): -5.0, (2, (2, 2, 2)): -1.0}
    changes |= {(0, BELOW): 3.0}
    changes |= {(1, BELOW): 3.0, (2, BELOW): 3.0, (0, (4, 4, 4)): 0.0}
    measurement = parse_merl(with_values(data, changes))
    expected = nodes_above_horizon().copy()
    expected[1, 1, 1] = False
    np.testing.assert_array_equal(measurement.valid, expected)
    for channel, known in enumerate(measurement.known(2)):
        np.testing.assert_array_equal(known[2, 2], channel < 2)


def test_mapped_file_is_what_is_read(plastic_file: Path, tmp_path: Path) -> None:
    read = read_merl(plastic_file)
    mapped = map_merl(plastic_file, read.sha256)
    np.testing.assert_array_equal(mapped.stored, read.stored)
    np.testing.assert_array_equal(mapped.valid, read.valid)
    assert (mapped.name, mapped.sha256) == (read.name, read.sha256)
    assert not mapped.stored.flags.writeable
    assert not mapped.valid.flags.writeable
    short = tmp_path / "short.binary"
    short.write_bytes(plastic_file.read_bytes()[:-8])
    with pytest.raises(ValueError, match="length"):
        map_merl(short, read.sha256)


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
    data: bytes, damage: list[tuple[int, bytes]], length: int, cuts: list[int]
) -> None:
    changed = bytearray(data)
    for place, content in damage:
        changed[place : place + len(content)] = content
    cut = bytes(changed[:length]).ljust(min(length, FILE_SIZE + 64), b"\0")
    assert in_pieces(cut, cuts) == whole(cut)


@examples(3)
@given(data=st.one_of(st.binary(max_size=80), st.binary(max_size=80).map(HEADER.__add__)), cuts=cut_places)
def test_short_byte_strings_are_refused(data: bytes, cuts: list[int]) -> None:
    with pytest.raises(MeasurementFormatError):
        parse_merl(data)
    assert in_pieces(data, cuts) == whole(data)
