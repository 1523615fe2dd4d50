"""Read and write the MERL ``.binary`` format: bytes <-> `Measurement` (Matusik et al. 2003).

A file is three little-endian int32 dimensions (90, 90, 180) followed by 3 x 90 x 90 x 180 little-endian
float64 values, whose axes are (channel, theta_half, theta_diff, phi_diff). A stored value times the channel's ``SCALE``
is the BRDF in 1/sr; a negative value marks a node without a measurement.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.data.files import write_atomically
from dsbrdf.data.geometry import GRID_SHAPE, nodes_above_horizon
from dsbrdf.data.measurement import Measurement, merl_pieces, stored_numbers
from dsbrdf.data.merl_validation import FILE_SIZE, HEADER_SIZE, SCALE, check_header, check_length, checked_values
from dsbrdf.errors import MeasurementFormatError


def parse_merl(data: bytes | bytearray | memoryview, name: str = "measurement") -> Measurement:
    """Return the measurement in the bytes of a MERL file.

    Parameters
    ----------
    data : bytes-like
        Content of a whole file; immutable bytes are not copied.
    name : str
        The material's name.

    Raises
    ------
    MeasurementFormatError
        With one sentence that says what is wrong and what would be right.
    """
    view = memoryview(data).cast("B")
    if not view.readonly:
        view = memoryview(bytes(view))
    stored, valid, sha256 = checked_values(view)
    return Measurement(stored=stored, scale=SCALE, valid=valid, name=name, sha256=sha256)


def read_merl(path: str | os.PathLike[str]) -> Measurement:
    """Read a MERL ``.binary`` file.

    Parameters
    ----------
    path : path-like
        The file; its stem becomes the measurement's name.

    Raises
    ------
    MeasurementFormatError
        With one sentence that says what is wrong and what would be right. The header and the length are
        checked before the values are read.
    OSError
        If the file does not exist or cannot be read.
    """
    source = Path(path)
    status = source.stat()
    if not source.is_file():
        kind = "a directory" if source.is_dir() else "not a regular file"
        raise MeasurementFormatError(f"{source} is {kind}; a MERL measurement is a file of {FILE_SIZE} bytes.")
    with source.open("rb") as file:
        check_header(file.read(HEADER_SIZE))
        check_length(status.st_size)
        file.seek(0)
        # One byte more than expected is read, to notice a file that has grown since its length was checked.
        data = file.read(FILE_SIZE + 1)
    return parse_merl(data, source.stem)


def map_merl(path: str | os.PathLike[str], sha256: str) -> Measurement:
    """Map a validated MERL file into memory, and return the measurement without another check.

    `sha256` is the digest of the file, which must not change while the measurement is in use. Raises ValueError if the
    file is shorter than a measurement.
    """
    source = Path(path)
    with source.open("rb") as file:
        data = mmap.mmap(file.fileno(), FILE_SIZE, access=mmap.ACCESS_READ)
    stored = np.frombuffer(data, dtype="<f8", offset=HEADER_SIZE).reshape(len(SCALE), *GRID_SHAPE)
    valid = nodes_above_horizon() & (stored >= 0.0).any(axis=0)
    valid.flags.writeable = False
    return Measurement(stored=stored, scale=SCALE, valid=valid, name=source.stem, sha256=sha256)


def encode_merl(measurement: Measurement | ArrayLike) -> bytes:
    """Return the bytes that `write_merl` writes to a file."""
    return b"".join(_pieces(measurement))


def write_merl(path: str | os.PathLike[str], measurement: Measurement | ArrayLike) -> None:
    """Write a MERL ``.binary`` file; after an error, no file is left and an existing file is unchanged.

    Parameters
    ----------
    path : path-like
        The file to write; an existing one is replaced.
    measurement : Measurement or array_like, shape (3, 90, 90, 180)
        The numbers of a measurement are written unchanged. An array has values in 1/sr; a negative value marks a node
        without a measurement.

    Raises
    ------
    MeasurementFormatError
        If the shape is wrong or a value is NaN or infinite.
    OSError
        If the file cannot be written.
    """
    write_atomically(path, _pieces(measurement))


def _pieces(measurement: Measurement | ArrayLike) -> Iterator[bytes | memoryview]:
    return merl_pieces(
        measurement.stored if isinstance(measurement, Measurement) else stored_numbers(measurement, None)
    )
