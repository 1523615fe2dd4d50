"""The tensor file: named arrays one after the other, the container of the RGL material database (Dupuy and Jakob 2018).

All numbers are little-endian:

    "tensor_file" 0x00, version 1 0 (two bytes), number of fields (uint32), and for each field
    length of the name (uint16), name, number of axes (uint16), type (uint8), offset of the data (uint64),
    length of each axis (uint64); the data follow.
"""

import struct
from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.errors import MeasurementFormatError

_MAGIC = b"tensor_file\0\x01\x00"
_TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")  # type 1 is the first
_ALIGNMENT = 8
_MOST_FIELDS, _MOST_AXES = 64, 8


def encode_tensors(fields: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the bytes of a tensor file with arrays by their names."""
    names = {name: name.encode() for name in fields}
    arrays = {name: np.asarray(array, array.dtype.newbyteorder("<"), order="C") for name, array in fields.items()}
    offset = len(_MAGIC) + 4 + sum(2 + len(names[name]) + 2 + 1 + 8 + 8 * arrays[name].ndim for name in fields)
    heads, bodies = [_MAGIC, struct.pack("<I", len(fields))], []
    for name, array in arrays.items():
        gap = -offset % _ALIGNMENT
        offset += gap
        code = _TYPES.index(array.dtype.str[1:]) + 1
        heads += [struct.pack("<H", len(names[name])), names[name], struct.pack("<HBQ", array.ndim, code, offset)]
        heads.append(struct.pack(f"<{array.ndim}Q", *array.shape))
        bodies += [bytes(gap), array.tobytes()]
        offset += array.nbytes
    return b"".join(heads + bodies)


def parse_tensors(data: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of a tensor file, read-only.

    Raises
    ------
    MeasurementFormatError
        If the bytes are of another kind, damaged or cut off.
    """
    if data[: len(_MAGIC)] != _MAGIC:
        raise MeasurementFormatError("The file is not a tensor file of version 1.0, as an RGL .bsdf file must be.")
    try:
        return _fields(data)
    except (struct.error, IndexError, UnicodeDecodeError, ValueError):
        raise MeasurementFormatError("The tensor file is damaged or cut off: a field lies outside of it.") from None


def _fields(data: bytes) -> dict[str, NDArray[Any]]:
    place = len(_MAGIC)

    def take(code: str) -> tuple[Any, ...]:
        nonlocal place
        values = struct.unpack_from(f"<{code}", data, place)
        place += struct.calcsize(f"<{code}")
        return values

    (count,) = take("I")
    if count > _MOST_FIELDS:
        raise ValueError
    fields = {}
    for _ in range(count):
        (length,) = take("H")
        (raw,) = take(f"{length}s")
        axes, code, offset = take("HBQ")
        shape = take(f"{axes}Q")
        if axes > _MOST_AXES or not 1 <= code <= len(_TYPES):
            raise ValueError
        kind = np.dtype("<" + _TYPES[code - 1])
        if offset + prod(shape) * kind.itemsize > len(data):
            raise ValueError
        fields[raw.decode()] = np.frombuffer(data, kind, prod(shape), offset).reshape(shape)
    return fields
