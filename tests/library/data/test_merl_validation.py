import os
import re
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.grid import GRID_SHAPE, nodes_above_horizon
from dsbrdf.data.merl import parse_merl, read_merl
from dsbrdf.data.merl_validation import FILE_SIZE, SCALE, MerlChecker, check_header
from dsbrdf.errors import MeasurementFormatError
from tests.support.merl_files import ABOVE, BELOW, HEADER, NODES, with_values


def streamed(data: bytes) -> str | None:
    """The sentence that a stream of pieces gets, if any."""
    checker = MerlChecker()
    try:
        for start in range(0, len(data), 65_537):
            checker.update(data[start : start + 65_537])
        checker.finish()
    except MeasurementFormatError as error:
        return str(error)
    return None


def refusal(data: bytes) -> str:
    """The sentence of the parser, after making sure that a stream gets the same."""
    with pytest.raises(MeasurementFormatError) as caught:
        parse_merl(data)
    sentence = str(caught.value)
    assert streamed(data) == sentence
    assert sentence.endswith(".")
    assert "\n" not in sentence
    return sentence


def test_checking_a_stream_takes_bounded_memory(data: bytes) -> None:
    nodes_above_horizon()  # shared by all streams
    tracemalloc.start()
    try:
        checker = MerlChecker()
        for start in range(0, len(data), 65_536):
            checker.update(data[start : start + 65_536])
        streaming = tracemalloc.get_traced_memory()[1]
        checker.finish()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert streaming < 800_000
    assert peak < 3_000_000


def test_single_bytes_can_be_streamed(data: bytes) -> None:
    checker = MerlChecker()
    for start in range(50):
        checker.update(data[start : start + 1])
    checker.update(memoryview(data)[50:])
    assert checker.n_bytes == FILE_SIZE
    np.testing.assert_array_equal(checker.finish(), parse_merl(data).valid)


@pytest.mark.parametrize("length", [1, 11, 12, 13, 19, 20, 12 + 8 * NODES, FILE_SIZE - 8, FILE_SIZE - 1])
def test_truncated_file_is_refused(data: bytes, length: int) -> None:
    assert re.search(f"only {length} bytes.*34992012", refusal(data[:length]))


def test_what_a_wrong_length_or_order_looks_like_is_named(data: bytes) -> None:
    assert refusal(b"").startswith("The data is empty; a MERL measurement has exactly 34992012 bytes")
    values = np.frombuffer(data, dtype="<f8", offset=12).astype("<f4")
    assert "the length of float32 values" in refusal(HEADER + values.tobytes())
    assert "big-endian" in refusal(struct.pack(">3i", 90, 90, 180) + data[12:])


@pytest.mark.parametrize("extra", [b"\0", bytes(8), bytes(2_000_000)])
def test_too_long_file_is_refused(data: bytes, extra: bytes) -> None:
    assert refusal(data + extra).startswith("The data is longer than 34992012 bytes")


def test_a_stream_is_refused_as_soon_as_it_is_too_long(data: bytes) -> None:
    checker = MerlChecker()
    checker.update(data)
    checker.update(b"")
    with pytest.raises(MeasurementFormatError, match="longer than 34992012 bytes"):
        checker.update(b"\0")


@pytest.mark.parametrize(
    ("dimensions", "fault"),
    [
        ((0, 90, 180), "theta_half is 0 and not 90"),
        ((90, 0, 180), "theta_diff is 0 and not 90"),
        ((-90, -90, 180), "theta_half is -90 and not 90, theta_diff is -90 and not 90"),
        ((90, 90, 2**31 - 1), "phi_diff is 2147483647 and not 180"),
        ((1, 1, 90 * 90 * 180), "theta_half is 1 and not 90"),
        ((180, 90, 90), "swapped: (180, 90, 90); a MERL measurement has (90, 90, 180)"),
        ((90, 180, 90), "swapped: (90, 180, 90); a MERL measurement has (90, 90, 180)"),
    ],
)
def test_dimensions_are_checked_one_by_one(data: bytes, dimensions: tuple[int, int, int], fault: str) -> None:
    header = struct.pack("<3i", *dimensions)
    assert fault in refusal(header + data[12:])
    assert fault in refusal(header + data[12:1000])  # rather than the length
    with pytest.raises(MeasurementFormatError, match=re.escape(fault)):
        check_header(header)


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"\x89PNG\r\n\x1a\n", "a PNG image"),
        (b"tensor_file\0\x01\x00", "an RGL .bsdf file, which dsbrdf convert turns into a MERL file"),
        (b"v/1\x01\2\0\0\0", "an OpenEXR image"),
        (b'{"measurement": ', "JSON"),
        (b"PK\x03\x04", "a ZIP archive"),
    ],
)
def test_other_formats_are_named(data: bytes, start: bytes, kind: str) -> None:
    for content in (start, start + data, start + data[:50]):
        assert f"The data is {kind}" in refusal(content)


def test_check_header_ignores_what_follows_and_needs_twelve_bytes(data: bytes) -> None:
    check_header(data[:12])
    check_header(data[:5000])
    with pytest.raises(MeasurementFormatError, match="only 11 bytes"):
        check_header(data[:11])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("channel", "color", "node"), [(0, "red", (0, 0, 0)), (1, "green", BELOW), (2, "blue", (89, 89, 179))]
)
def test_value_that_is_not_finite_is_located(
    data: bytes, value: float, channel: int, color: str, node: tuple[int, int, int]
) -> None:
    assert refusal(with_values(data, {(channel, node): value})) == (
        f"1 value, in the {color} channel at (theta_half, theta_diff, phi_diff) node "
        f"{node}, is NaN or infinite; every value must be finite."
    )


def test_values_that_are_not_finite_are_counted(data: bytes) -> None:
    changes = {(2, (0, 0, 0)): np.nan, (1, (5, 6, 7)): np.inf, (1, BELOW): -np.inf, (0, ABOVE): 1e300}
    sentence = refusal(with_values(data, changes))
    assert sentence.startswith("3 values, the first in the green channel at")
    assert "node (5, 6, 7), are NaN or infinite" in sentence


@pytest.mark.parametrize(("channel", "color"), [(0, "red"), (1, "green"), (2, "blue")])
def test_largest_value_is_a_limit_of_the_scaled_brdf(data: bytes, channel: int, color: str) -> None:
    limit = 1e8 / SCALE[channel]
    sentence = refusal(with_values(data, {(channel, ABOVE): limit * 1.001, (channel, (11, 0, 0)): limit * 2}))
    assert sentence.startswith(f"2 values, the first in the {color} channel at")
    assert "node (10, 20, 30), exceed 1e8/sr" in sentence
    within = parse_merl(with_values(data, {(channel, ABOVE): limit * 0.999, (channel, BELOW): 1e300}))
    assert not within.valid[BELOW]


def table(value: float, valid: NDArray[np.bool_]) -> bytes:
    return HEADER + np.where(np.stack([valid] * 3), value, -1.0).astype("<f8").tobytes()


def test_file_with_hardly_any_valid_nodes_is_refused() -> None:
    above = nodes_above_horizon()
    index = np.flatnonzero(above)
    for share, accepted in ((0.0, False), (0.0099, False), (0.0101, True)):
        valid = np.zeros(GRID_SHAPE, dtype=bool)
        valid[~above] = True  # these do not count
        valid.flat[index[: int(share * index.size)]] = True
        data = table(1.0, valid)
        if accepted:
            assert parse_merl(data).valid.sum() == int(share * index.size)
        else:
            sentence = refusal(data)
            assert f"of valid ones (not negative) in the red channel is {int(share * index.size)};" in sentence
            assert "at least 1% of them in every channel" in sentence
    values = np.ones((3, *GRID_SHAPE))
    values[2].flat[index[int(0.0099 * index.size) :]] = -1.0
    assert "in the blue channel" in refusal(HEADER + values.astype("<f8").tobytes())


def test_file_of_zeros_is_refused() -> None:
    assert refusal(table(0.0, np.ones(GRID_SHAPE, dtype=bool))).startswith("Every valid node is zero")
    # Positive values below the horizon do not help, one above it does.
    values = np.zeros((3, *GRID_SHAPE))
    values[0][BELOW] = 1.0
    refusal(HEADER + values.astype("<f8").tobytes())
    values[2][ABOVE] = 1e-9
    assert parse_merl(HEADER + values.astype("<f8").tobytes()).valid[ABOVE]


def test_missing_file_directory_and_pipe_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_merl(tmp_path / "missing.binary")
    with pytest.raises(MeasurementFormatError, match="is a directory; a MERL measurement is a file of 34992012"):
        read_merl(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(MeasurementFormatError, match="is not a regular file"):
        read_merl(tmp_path / "pipe")


def test_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.binary"
    with path.open("wb") as file:
        file.write(HEADER)
        file.truncate(10 << 30)  # sparse
    tracemalloc.start()
    try:
        with pytest.raises(MeasurementFormatError, match="longer than 34992012 bytes"):
            read_merl(path)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_file_and_bytes_get_the_same_sentence(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "faulty.binary"
    for content in (b"abc", data[:500], data + b"\0", with_values(data, {(0, ABOVE): np.nan})):
        path.write_bytes(content)
        with pytest.raises(MeasurementFormatError) as from_file:
            read_merl(path)
        assert str(from_file.value) == refusal(content)
