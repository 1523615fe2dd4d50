"""Tensor files: round trip, the layout by hand, and damaged ones."""

import struct
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.tensor_file import encode_tensors, parse_tensors
from dsbrdf.errors import MeasurementFormatError

FIELDS: dict[str, NDArray[Any]] = {
    "description": np.frombuffer(b"nickel", np.uint8),
    "theta_i": np.linspace(0.0, 1.5, 4, dtype=np.float32),
    "rgb": np.arange(24.0).reshape(2, 3, 4),
}
CONTENT = encode_tensors(FIELDS)


def test_round_trip() -> None:
    found = parse_tensors(CONTENT)
    assert list(found) == list(FIELDS)
    for name, array in FIELDS.items():
        assert found[name].dtype == array.dtype
        assert np.array_equal(found[name], array)


def test_layout() -> None:
    expected = b"tensor_file\0\x01\x00" + struct.pack("<I", 1) + struct.pack("<H", 1) + b"a"
    expected += struct.pack("<HBQQ", 1, 10, 40, 1) + struct.pack("<f", 2.5)
    assert encode_tensors({"a": np.array([2.5], np.float32)}) == expected


@pytest.mark.parametrize("length", range(14, len(CONTENT), 7))
def test_cut_file_is_refused(length: int) -> None:
    with pytest.raises(MeasurementFormatError, match="damaged or cut off"):
        parse_tensors(CONTENT[:length])


@pytest.mark.parametrize("content", [b"", b"PNG", b"tensor_file\0\x02\x00" + CONTENT[14:]])
def test_another_kind_of_file_is_refused(content: bytes) -> None:
    with pytest.raises(MeasurementFormatError, match=r"not a tensor file of version 1\.0"):
        parse_tensors(content)
