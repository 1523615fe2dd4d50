"""The MERL ``.binary`` format: bytes <-> `Measurement` (Matusik et al. 2003).

A file is three little-endian int32 dimensions (90, 90, 180) followed by 3 x 90 x 90 x 180 little-endian
float64 values, axes (channel, theta_half, theta_diff, phi_diff). A stored value times the channel's ``SCALE``
is the BRDF in 1/sr; a negative value marks a node without a measurement.

`MerlChecker` takes the bytes in pieces of any size, so that a file can be checked while it arrives;
`parse_merl` and `read_merl` go through the same code. The order of precedence is fixed, whatever the pieces:
the header, the length, then the values, so that one file always gets one and the same sentence.
"""

import hashlib
import os
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.errors import MeasurementFormatError
from dsbrdf.files import write_atomically
from dsbrdf.measurement import CHANNELS, GRID_SHAPE, Measurement, nodes_above_horizon

__all__ = [
    "FILE_SIZE",
    "HEADER_SIZE",
    "LARGEST_VALUE",
    "SCALE",
    "MerlChecker",
    "check_header",
    "check_length",
    "encode_merl",
    "parse_merl",
    "read_merl",
    "write_merl",
]

HEADER_SIZE = 12
NODES = 90 * 90 * 180
FILE_SIZE = HEADER_SIZE + 3 * NODES * 8
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
SCALE.flags.writeable = False
LARGEST_VALUE = 1e8  # [1/sr]; no reflectance comes near it
SMALLEST_VALID_SHARE = 0.01

_HEADER = struct.pack("<3i", *GRID_SHAPE)
_FLOAT32_SIZE = HEADER_SIZE + 3 * NODES * 4
_SHAPE = (len(CHANNELS), *GRID_SHAPE)
_AXES = ("theta_half", "theta_diff", "phi_diff")
_PIECE = 1 << 20


def check_header(header: bytes | bytearray | memoryview) -> None:
    """Check the first 12 bytes of a file: its three dimensions, each on its own.

    Parameters
    ----------
    header : bytes-like
        At least the first 12 bytes; what follows is ignored.

    Raises
    ------
    MeasurementFormatError
        If there are fewer than 12 bytes or a dimension is not that of the MERL grid.
    """
    start = bytes(header[:HEADER_SIZE])
    if len(start) < HEADER_SIZE:
        check_length(len(start))
    if start == _HEADER:
        return
    found = struct.unpack("<3i", start)
    right = f"a MERL measurement has {GRID_SHAPE} for (theta_half, theta_diff, phi_diff)"
    if struct.unpack(">3i", start) == GRID_SHAPE:
        fault = "are stored big-endian; a MERL file is little-endian throughout"
        raise MeasurementFormatError(f"The dimensions {GRID_SHAPE} in the header {fault}.")
    if sorted(found) == sorted(GRID_SHAPE):
        raise MeasurementFormatError(f"The dimensions in the header are swapped: {found}; {right}.")
    wrong = [
        f"{axis} is {size} and not {expected}"
        for axis, size, expected in zip(_AXES, found, GRID_SHAPE, strict=True)
        if size != expected
    ]
    raise MeasurementFormatError(f"The dimensions in the header are {found}: {', '.join(wrong)}; {right}.")


def check_length(n_bytes: int) -> None:
    """Check the length of a whole file, header included.

    Parameters
    ----------
    n_bytes : int
        Its length in bytes.

    Raises
    ------
    MeasurementFormatError
        If it is not ``FILE_SIZE``.
    """
    if n_bytes == FILE_SIZE:
        return
    right = f"a MERL measurement has exactly {FILE_SIZE} bytes (12 + 3 x 90 x 90 x 180 x 8)"
    if n_bytes > FILE_SIZE:
        # The sentence is the same whether the whole length is known or a stream was cut off.
        raise MeasurementFormatError(f"The data is longer than {FILE_SIZE} bytes; {right}.")
    if n_bytes == 0:
        raise MeasurementFormatError(f"The data is empty; {right}.")
    if n_bytes == _FLOAT32_SIZE:
        raise MeasurementFormatError(
            f"The data has {n_bytes} bytes, the length of float32 values; {right}, its values being float64."
        )
    raise MeasurementFormatError(f"The data has only {n_bytes} bytes and seems cut off; {right}.")


class MerlChecker:
    """Check the bytes of a MERL file piece by piece, in bounded memory.

    Feed every byte in order with `update`, then call `finish`. Beyond the piece at hand it keeps about 3 MB:
    two flags per node.

    Attributes
    ----------
    n_bytes : int
        How many bytes were seen.
    """

    def __init__(self) -> None:
        self.n_bytes = 0
        self._header = b""
        self._rest = b""  # the first bytes of a value that the next piece completes
        self._n_values = 0
        self._measured = np.ones(NODES, dtype=np.bool_)
        self._positive = np.zeros(NODES, dtype=np.bool_)
        self._above = nodes_above_horizon().reshape(-1)
        self._not_finite = _Fault()
        self._too_large = _Fault()

    def update(self, piece: bytes | bytearray | memoryview) -> None:
        """Take the next bytes.

        Parameters
        ----------
        piece : bytes-like
            Of any length.

        Raises
        ------
        MeasurementFormatError
            As soon as the header is wrong or there are more bytes than a file has. Wrong values are reported
            by `finish`, because their count is part of the sentence.
        """
        view = memoryview(piece).cast("B")
        if len(self._header) < HEADER_SIZE:
            taken = HEADER_SIZE - len(self._header)
            self._header += bytes(view[:taken])
            self.n_bytes += len(view[:taken])
            view = view[taken:]
            if len(self._header) == HEADER_SIZE:
                check_header(self._header)
        self.n_bytes += len(view)
        if self.n_bytes > FILE_SIZE:
            check_length(self.n_bytes)
        if self._rest and len(view) > 0:
            taken = 8 - len(self._rest)
            self._rest += bytes(view[:taken])
            view = view[taken:]
            if len(self._rest) == 8:
                self._take(np.frombuffer(self._rest, dtype="<f8"))
                self._rest = b""
        whole = len(view) // 8 * 8
        if whole:
            self._take(np.frombuffer(view[:whole], dtype="<f8"))
        if whole < len(view):
            self._rest = bytes(view[whole:])

    def finish(self) -> NDArray[np.bool_]:
        """Conclude after the last byte.

        Returns
        -------
        ndarray of bool, shape (90, 90, 180)
            The valid nodes: no channel negative and both directions strictly above the horizon.

        Raises
        ------
        MeasurementFormatError
            If the length is wrong, a value is NaN or infinite or above 1e8/sr, fewer than 1 % of the nodes
            above the horizon are valid, or all valid nodes are zero.
        """
        check_length(self.n_bytes)
        if self._not_finite.count:
            raise MeasurementFormatError(
                f"{self._not_finite.sentence('is', 'are')} NaN or infinite; every value must be finite."
            )
        if self._too_large.count:
            raise MeasurementFormatError(
                f"{self._too_large.sentence('exceeds', 'exceed')} 1e8/sr, which no reflectance has; "
                "stored values are the BRDF in 1/sr times 1500 / (1, 1.15, 1.66)."
            )
        valid = self._measured & self._above
        n_valid, n_above = int(valid.sum()), int(self._above.sum())
        if n_valid < SMALLEST_VALID_SHARE * n_above:
            raise MeasurementFormatError(
                f"Of the {n_above} nodes above the horizon, the number of valid ones (no channel negative) is "
                f"{n_valid}; a measurement needs at least {SMALLEST_VALID_SHARE:.0%} of them."
            )
        if not (valid & self._positive).any():
            raise MeasurementFormatError(
                "Every valid node is zero in all channels; a measurement has positive values."
            )
        return valid.reshape(GRID_SHAPE)

    def _take(self, values: NDArray[np.float64]) -> None:
        """Record whole values, which may span channels."""
        while values.size:
            channel, node = divmod(self._n_values, NODES)
            part = values[: NODES - node]
            values = values[part.size :]
            self._inspect(part, channel, slice(node, node + part.size))
            self._n_values += part.size

    def _inspect(self, values: NDArray[np.float64], channel: int, nodes: slice) -> None:
        limit = LARGEST_VALUE / SCALE[channel]
        largest, smallest = values.max(), values.min()
        if not (np.isfinite(largest) and np.isfinite(smallest)):
            self._not_finite.record(~np.isfinite(values), channel, nodes.start)
        # Phrased so that NaN takes part in the comparison without being found too large.
        if not largest <= limit:
            with np.errstate(invalid="ignore"):
                self._too_large.record((values > limit) & self._above[nodes], channel, nodes.start)
        self._measured[nodes] &= values >= 0.0
        self._positive[nodes] |= values > 0.0


class _Fault:
    """How often a fault occurs, and where first."""

    def __init__(self) -> None:
        self.count = 0
        self._first = ""

    def record(self, where: NDArray[np.bool_], channel: int, start: int) -> None:
        found = np.flatnonzero(where)
        if found.size and not self.count:
            node = tuple(int(index) for index in np.unravel_index(start + int(found[0]), GRID_SHAPE))
            self._first = (
                f"in the {CHANNELS[channel]} channel at (theta_half, theta_diff, phi_diff) node {node}"
            )
        self.count += found.size

    def sentence(self, one: str, many: str) -> str:
        if self.count == 1:
            return f"1 value, {self._first}, {one}"
        return f"{self.count} values, the first {self._first}, {many}"


def parse_merl(data: bytes | bytearray | memoryview, name: str = "measurement") -> Measurement:
    """Measurement in the bytes of a MERL file.

    Parameters
    ----------
    data : bytes-like
        The whole file. Immutable bytes are used in place, not copied.
    name : str
        The material's name.

    Returns
    -------
    Measurement

    Raises
    ------
    MeasurementFormatError
        With one sentence that says what is wrong and what would be right.
    """
    view = memoryview(data).cast("B")
    if not view.readonly:
        view = memoryview(bytes(view))
    check_header(view[:HEADER_SIZE] if len(view) >= HEADER_SIZE else view)
    check_length(len(view))
    checker, digest = MerlChecker(), hashlib.sha256()
    for start in range(0, len(view), _PIECE):
        piece = view[start : start + _PIECE]
        checker.update(piece)
        digest.update(piece)
    valid = checker.finish()
    valid.flags.writeable = False
    stored = np.frombuffer(view, dtype="<f8", offset=HEADER_SIZE).reshape(_SHAPE)
    return Measurement(stored=stored, scale=SCALE, valid=valid, name=name, sha256=digest.hexdigest())


def read_merl(path: str | os.PathLike[str]) -> Measurement:
    """Read a MERL ``.binary`` file.

    Parameters
    ----------
    path : path-like
        The file; its stem becomes the measurement's name.

    Returns
    -------
    Measurement

    Raises
    ------
    MeasurementFormatError
        With one sentence that says what is wrong and what would be right. A file of a wrong header or length
        is refused before its values are read.
    OSError
        If the file does not exist or cannot be read.
    """
    source = Path(path)
    status = source.stat()
    if not source.is_file():
        kind = "a directory" if source.is_dir() else "not a regular file"
        raise MeasurementFormatError(
            f"{source} is {kind}; a MERL measurement is a file of {FILE_SIZE} bytes."
        )
    with source.open("rb") as file:
        check_header(file.read(HEADER_SIZE))
        check_length(status.st_size)
        file.seek(0)
        # One byte more than needed tells a file that has grown since.
        data = file.read(FILE_SIZE + 1)
    return parse_merl(data, source.stem)


def encode_merl(measurement: Measurement | ArrayLike, valid: ArrayLike | None = None) -> bytes:
    """Bytes of a MERL file.

    Parameters
    ----------
    measurement : Measurement or array_like, shape (3, 90, 90, 180)
        A measurement is encoded bit for bit as it was read; an array is the BRDF in 1/sr, negative where
        there is no value.
    valid : array_like of bool, shape (90, 90, 180), optional
        For an array: the nodes that carry a value. The others are stored as -1, whatever they hold.

    Returns
    -------
    bytes
        ``FILE_SIZE`` of them.

    Raises
    ------
    MeasurementFormatError
        If a shape is wrong or a value is NaN or infinite.
    """
    return b"".join(_parts(measurement, valid))


def write_merl(path: str | os.PathLike[str], measurement: Measurement | ArrayLike) -> None:
    """Write a MERL ``.binary`` file, whole or not at all.

    Parameters
    ----------
    path : path-like
        Where to write; an existing file is replaced.
    measurement : Measurement or array_like, shape (3, 90, 90, 180)
        A measurement is written bit for bit as it was read; an array is the BRDF in 1/sr, negative where
        there is no value.

    Raises
    ------
    MeasurementFormatError
        If the shape is wrong or a value is NaN or infinite.
    OSError
        If the file cannot be written.
    """
    write_atomically(path, _parts(measurement, None))


def _parts(measurement: Measurement | ArrayLike, valid: ArrayLike | None) -> Iterator[bytes | memoryview]:
    stored = measurement.stored if isinstance(measurement, Measurement) else _stored(measurement, valid)
    yield _HEADER
    for channel in stored:
        yield np.ascontiguousarray(channel, dtype="<f8").data.cast("B")


def _stored(values: ArrayLike, valid: ArrayLike | None) -> NDArray[np.float64]:
    """Numbers for the file: values [1/sr] divided by the scale, -1 where there is none."""
    try:
        brdf = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise MeasurementFormatError(f"The values must be real numbers of the shape {_SHAPE}.") from None
    if brdf.shape != _SHAPE:
        raise MeasurementFormatError(f"The values have the shape {brdf.shape}; a measurement has {_SHAPE}.")
    stored = brdf / SCALE[:, np.newaxis, np.newaxis, np.newaxis]
    if valid is not None:
        mask = np.asarray(valid, dtype=np.bool_)
        if mask.shape != GRID_SHAPE:
            raise MeasurementFormatError(
                f"The valid nodes have the shape {mask.shape}; it must be {GRID_SHAPE}."
            )
        stored[:, ~mask] = -1.0
    if not np.isfinite(stored).all():
        count = int((~np.isfinite(stored)).sum())
        raise MeasurementFormatError(
            f"{count} of the values are NaN or infinite; every value must be finite."
        )
    return stored
