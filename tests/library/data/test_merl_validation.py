import json
import os
import re
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError, parse_merl, read_merl, read_samples
from dsbrdf.data import FILE_SIZE, GRID_SHAPE, nodes_above_horizon
from dsbrdf.data.merl_validation import SCALE
from tests.support.merl_files import ABOVE, BELOW, HEADER, NODES, header, with_values
from tests.support.reproduced import assert_reproduced


def whole(data: bytes) -> str:
    """The sha256 and the number of valid nodes of a file read at once, or the sentence that refuses it."""
    try:
        measurement = parse_merl(data)
    except MeasurementFormatError as error:
        return str(error)
    return f"{measurement.sha256} {measurement.valid.sum()}"


def refusal(data: bytes) -> str:
    sentence = whole(data)
    assert re.fullmatch(r".*\.", sentence)
    return sentence


Make = Callable[[bytes], bytes]


def floats(data: bytes) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.frombuffer(data, "<f8", offset=12)


SIGNALLING = struct.pack("<Q", 0x7FF0000000000001)
FAULTS: dict[str, Make] = {
    "empty": lambda _: b"",
    "a cut header": lambda data: data[:11],
    "one channel": lambda data: data[: 12 + 8 * NODES],
    "one byte less": lambda data: data[:-1],
    "one byte more": lambda data: data + b"\0",
    "another grid": lambda data: header(90, 91, 179) + data[12:100_000],
    "swapped": lambda data: header(180, 90, 90) + data[12:100_000],
    "big-endian": lambda data: header(90, 90, 180, order=">") + data[12:],
    "float32": lambda data: HEADER + floats(data).astype("<f4").tobytes(),
    "a signalling nan": lambda data: data[:5_600_012] + SIGNALLING + data[5_600_020:],
    "a nan in red": lambda data: with_values(data, {(0, (0, 0, 0)): np.nan}),
    "infinity in green": lambda data: with_values(data, {(1, BELOW): np.inf}),
    "minus infinity in blue": lambda data: with_values(data, {(2, (89, 89, 179)): -np.inf}),
    "three not finite": lambda data: with_values(
        data, {(2, (0, 0, 0)): np.nan, (1, (5, 6, 7)): np.inf, (1, BELOW): -np.inf, (0, ABOVE): 1e300}
    ),
    "all zero": lambda _: HEADER + bytes(24 * NODES),
    "another unit": lambda data: HEADER + (1e-30 * floats(data)).tobytes(),
    "JSON": lambda _: json.dumps({"measurement": [1.0] * 1000}).encode(),
    "a text": lambda _: b"# dsbrdf\n\nCompact models",
    "ZIP": lambda _: b"PK\x03\x04",
    "RGL": lambda _: b"tensor_file\0\x01\x00",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_no_measurement_is_named(data: bytes, fault: str) -> None:
    assert_reproduced(f"refused/MERL: {fault}", refusal(FAULTS[fault](data)))


@pytest.mark.parametrize(("channel", "color"), [(0, "red"), (1, "green"), (2, "blue")])
def test_largest_value_is_a_limit_of_the_scaled_brdf(data: bytes, channel: int, color: str) -> None:
    limit = 1e8 / SCALE[channel]
    sentence = refusal(with_values(data, {(channel, ABOVE): limit * 1.001, (channel, (11, 0, 0)): limit * 2}))
    assert sentence.startswith(f"2 values, the first in the {color} channel at")
    assert "node (10, 20, 30), exceed 1e8/sr" in sentence
    within = parse_merl(with_values(data, {(channel, ABOVE): limit * 0.999, (channel, BELOW): 1e300}))
    assert not within.valid[BELOW]


def test_file_with_hardly_any_valid_nodes_is_refused() -> None:
    index = np.flatnonzero(nodes_above_horizon())  # the others do not count
    for share, channel, color in ((0.0, 0, "red"), (0.0099, 1, "green"), (0.0099, 2, "blue"), (0.0101, 2, "")):
        values, count = np.ones((3, *GRID_SHAPE)), int(share * index.size)
        values[channel].flat[index[count:]] = -1.0
        sentence = whole(HEADER + values.tobytes())
        refused = f"The {color} channel has valid values (not negative) at {count} of the"
        assert (refused in sentence) == bool(color)


def test_nodes_below_the_horizon_and_single_ones_are_no_measurement() -> None:
    above = nodes_above_horizon()
    count = int(0.001 * above.sum()) + 1
    for lit, elsewhere in ((0, 1.0), (count - 1, 0.0), (count, 0.0)):
        values = np.where(above, 0.0, np.full((3, *GRID_SHAPE), elsewhere))
        values[:, 0] = elsewhere  # A fit does not see light at theta_half = 0, which has no solid angle.
        values[0, 1:].flat[np.flatnonzero(above[1:])[:lit]] = 1e-4  # 6.7e-8/sr
        sentence = whole(HEADER + values.tobytes())
        assert (f"{lit} of the {above.sum()} nodes above the horizon have a value" in sentence) == (lit < count)


def test_missing_file_directory_and_pipe_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_merl(tmp_path / "missing.binary")
    with pytest.raises(MeasurementFormatError, match="is a directory; a MERL measurement is a file of 34992012"):
        read_merl(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(MeasurementFormatError, match="is not a regular file"):
        read_merl(tmp_path / "pipe")


@pytest.mark.parametrize(
    ("read", "start", "limit"), [(read_merl, HEADER, FILE_SIZE), (read_samples, b"a,b\n", 1 << 30)]
)
def test_huge_file_is_refused_unread(read: Callable[[Path], object], start: bytes, limit: int, tmp_path: Path) -> None:
    path = tmp_path / "huge.binary"
    with path.open("wb") as file:
        file.write(start)
        file.truncate(10 << 30)  # sparse
    tracemalloc.start()
    try:
        with pytest.raises(MeasurementFormatError, match=f"longer than {limit} bytes"):
            read(path)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()
