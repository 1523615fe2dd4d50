import dataclasses
import hashlib
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dsbrdf import Measurement, MeasurementFormatError, parse_merl, read_merl, write_merl
from dsbrdf.data import (
    CHANNELS,
    FILE_SIZE,
    GRID_SHAPE,
    PHI_DIFF,
    THETA_DIFF,
    THETA_HALF,
    directions,
    encode_merl,
    nodes_above_horizon,
)
from dsbrdf.data.files import write_atomically
from dsbrdf.data.merl import map_merl
from tests.support.merl_files import ABOVE, BELOW, HEADER, position, with_values


def test_file_layout_is_that_of_the_merl_format(data: bytes, plastic: Measurement) -> None:
    assert data[:12] == HEADER
    assert len(data) == FILE_SIZE == 34_992_012
    for channel, node in ((0, (0, 0, 0)), (1, (3, 4, 5)), (2, (89, 89, 179))):
        assert plastic.stored[channel][node] == struct.unpack_from("<d", data, position(channel, node))[0]
    for values, stored, factor in zip(plastic.values, plastic.stored, (1.0, 1.15, 1.66), strict=True):
        np.testing.assert_allclose(values, stored * factor / 1500.0, rtol=4e-16)


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
    assert measurement.values[0, 0, 0, 0] == 0.0


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
    with pytest.raises(TypeError):
        write_atomically(path, [b"half", None])  # type: ignore[list-item]
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]
    old = tmp_path / "old"
    os.link(path, old)
    write_merl(path, np.ones((3, *GRID_SHAPE)))
    assert old.read_bytes() == b"before"  # another file takes the place, once it is whole
    with pytest.raises(FileNotFoundError):
        write_merl(tmp_path / "missing" / "a.binary", np.ones((3, *GRID_SHAPE)))


def test_written_files_have_ordinary_permissions_and_names_of_any_length(tmp_path: Path) -> None:
    (tmp_path / "b").write_bytes(b"")
    for name in ("a", "\N{GLOWING STAR}" * 63, "a" * 255):
        write_atomically(tmp_path / name, [b"whole"])
        assert (tmp_path / name).stat().st_mode == (tmp_path / "b").stat().st_mode
    with pytest.raises(IsADirectoryError):
        write_atomically(tmp_path, [b"whole"])


def test_valid_needs_a_channel_and_the_horizon(data: bytes) -> None:
    changes = {(0, (1, 1, 1)): -1.0, (1, (1, 1, 1)): -1e-300, (2, (1, 1, 1)): -5.0, (2, (2, 2, 2)): -1.0}
    changes |= {(0, BELOW): 3.0, (1, BELOW): 3.0, (2, BELOW): 3.0, (0, (4, 4, 4)): 0.0}
    measurement = parse_merl(with_values(data, changes))
    expected = nodes_above_horizon().copy()
    expected[1, 1, 1] = False
    np.testing.assert_array_equal(measurement.valid, expected)
    assert measurement.values[2, 2, 2, 2] == 0.0


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


def test_grid_stands_at_the_left_edges() -> None:
    assert CHANNELS == ("red", "green", "blue")
    assert GRID_SHAPE == (len(THETA_HALF), len(THETA_DIFF), len(PHI_DIFF))
    np.testing.assert_allclose(np.degrees(THETA_HALF[[0, 1, 30, 89]]), [0.0, 1 / 90, 10.0, 89**2 / 90])
    np.testing.assert_allclose(np.degrees(THETA_DIFF[[0, 1, 89]]), [0.0, 1.0, 89.0])
    np.testing.assert_allclose(np.degrees(PHI_DIFF[[0, 1, 179]]), [0.0, 1.0, 179.0])


def test_nodes_above_horizon_agree_with_the_directions() -> None:
    above = nodes_above_horizon()
    assert above.shape == GRID_SHAPE
    omega_in, omega_out = directions(THETA_HALF[::7, None, None], THETA_DIFF[::3, None], PHI_DIFF[::5])
    expected = (omega_in[..., 2] > 1e-13) & (omega_out[..., 2] > 1e-13)
    np.testing.assert_array_equal(above[::7, ::3, ::5], expected)
    assert not above[30, 80, 0]  # 10 + 80 degrees: on the horizon


def test_a_measurement_and_its_grid_cannot_be_changed(plastic: Measurement) -> None:
    grid = (THETA_HALF, THETA_DIFF, PHI_DIFF, nodes_above_horizon())
    assert not any(array.flags.writeable for array in (plastic.stored, plastic.valid, plastic.scale, *grid))
    with pytest.raises(dataclasses.FrozenInstanceError):
        plastic.name = "other"  # type: ignore[misc]


def test_from_values_equals_reading_the_encoded_bytes() -> None:
    values = np.random.default_rng(3).uniform(0.1, 5.0, (3, *GRID_SHAPE))
    values[:, 4, 5, 6] = -2.0
    valid = np.ones(GRID_SHAPE, dtype=bool)
    valid[7, 8, 9] = False
    values[:, 7, 8, 9] = np.nan  # what an invalid node holds does not matter
    measurement = Measurement.from_values(values, valid, name="random")
    expected = nodes_above_horizon().copy()
    expected[4, 5, 6] = expected[7, 8, 9] = False
    np.testing.assert_array_equal(measurement.valid, expected)
    np.testing.assert_allclose(measurement.values[:, valid], values[:, valid], rtol=5e-16)
    np.testing.assert_array_equal(measurement.stored[:, 7, 8, 9], -1.0)
    assert measurement.name == "random"
    assert measurement.sha256 == hashlib.sha256(encode_merl(measurement)).hexdigest()


def test_from_values_names_the_fault() -> None:
    zeros, ones = np.zeros((3, *GRID_SHAPE)), np.ones((3, *GRID_SHAPE))
    wrong: list[tuple[Any, Any, str]] = [
        (np.moveaxis(zeros, 0, -1), None, r"have the shape \(.*; a measurement has \(3, 90, 90, 180\)"),
        (ones, np.ones((90, 180, 90), bool), r"valid nodes have the shape \(90, 180, 90\)"),
        (zeros, None, "have a value of at least"),
        (np.array([["a"]]), None, "must be real numbers"),
        ({"values": ones}, None, "an object of type dict has no such numbers"),
        (np.where(np.arange(180) == 7, np.inf, ones), None, "^24300 of the values are NaN"),
    ]
    for values, valid, words in wrong:
        with pytest.raises(MeasurementFormatError, match=words):
            Measurement.from_values(values, valid)
