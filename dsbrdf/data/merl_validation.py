"""Check a MERL ``.binary`` file: first the header, then the length, then the values.

`dsbrdf.data.merl` describes the format of the file.
"""

import hashlib
import struct
from collections.abc import Iterable, Sequence

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.files import known_kind
from dsbrdf.data.geometry import CHANNELS, GRID_SHAPE, nodes_above_horizon
from dsbrdf.errors import MeasurementFormatError

HEADER = struct.pack("<3i", *GRID_SHAPE)
HEADER_SIZE = len(HEADER)
NODES = 90 * 90 * 180
N_ROWS, *_ROW_SHAPE = GRID_SHAPE
ROW_NODES = NODES // N_ROWS
FILE_SIZE = HEADER_SIZE + 3 * NODES * 8
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
SCALE.flags.writeable = False
MAX_VALUE = 1e8  # A file with a larger value is refused, because no BRDF is so large [1/sr].
MIN_NONZERO_VALUE = 1e-8  # Smaller values count as zero, because every real material is brighter [1/sr].
# A file is refused if a channel has valid values at a smaller fraction of the nodes above the horizon.
MIN_VALID_FRACTION = 0.01
# A file is refused if a smaller fraction of its nodes has a nonzero value, because so few values are noise.
MIN_NONZERO_FRACTION = 0.001

_KIND_SIZE = 64  # This number of bytes at the beginning of a file is enough to recognise other kinds of files.
_FLOAT32_FILE_SIZE = HEADER_SIZE + 3 * NODES * 4
SHAPE = (len(CHANNELS), *GRID_SHAPE)
_AXES = ("theta_half", "theta_diff", "phi_diff")
_MAX_LIKELY_SIZE = 100_000  # A header with a larger number has no dimensions of a grid: the file is of another kind.
_NOT_FINITE = "NaN or infinite; every value must be finite."
_UNIT = "Stored values are the BRDF in 1/sr times 1500 / (1, 1.15, 1.66)."
_TOO_LARGE = f"1e8/sr, which no reflectance has. {_UNIT}"


def check_header(header: bytes | bytearray | memoryview) -> None:
    """Raise MeasurementFormatError unless the first 12 bytes of a file are the dimensions of the MERL grid."""
    start = bytes(header[:HEADER_SIZE])
    if (kind := known_kind(bytes(header[:_KIND_SIZE]))) is not None:
        raise MeasurementFormatError(f"The data is {kind}.")
    if len(start) < HEADER_SIZE:
        check_length(len(start))
    if start == HEADER:
        return
    found = struct.unpack("<3i", start)
    right = f"a MERL measurement has {GRID_SHAPE} for (theta_half, theta_diff, phi_diff)"
    if struct.unpack(">3i", start) == GRID_SHAPE:
        fault = "are stored big-endian; a MERL file is little-endian throughout"
        raise MeasurementFormatError(f"The dimensions {GRID_SHAPE} in the header {fault}.")
    if sorted(found) == sorted(GRID_SHAPE):
        raise MeasurementFormatError(f"The dimensions in the header are swapped: {found}; {right}.")
    if not all(abs(size) < _MAX_LIKELY_SIZE for size in found):
        text = start.decode("utf-8", "ignore")
        if len(text) > HEADER_SIZE - 4 and all(letter.isprintable() or letter.isspace() for letter in text):
            first = text.split("\n")[0]
            raise MeasurementFormatError(f"The data is a text that begins with {first!r}, and no MERL measurement.")
        raise MeasurementFormatError(f"The data is no MERL measurement, which begins with the dimensions {GRID_SHAPE}.")
    pairs = zip(_AXES, found, GRID_SHAPE, strict=True)
    wrong = [f"{axis} is {size} and not {expected}" for axis, size, expected in pairs if size != expected]
    raise MeasurementFormatError(f"The dimensions in the header are {found}: {', '.join(wrong)}; {right}.")


def check_length(n_bytes: int) -> None:
    """Raise MeasurementFormatError unless `n_bytes`, the length of a file with its header, is `FILE_SIZE`."""
    if n_bytes == FILE_SIZE:
        return
    right = f"a MERL measurement has exactly {FILE_SIZE} bytes (12 + 3 x 90 x 90 x 180 x 8)"
    if n_bytes > FILE_SIZE:
        # This message does not name the file's length, which is still unknown during an upload.
        raise MeasurementFormatError(f"The data is longer than {FILE_SIZE} bytes; {right}.")
    if n_bytes == 0:
        raise MeasurementFormatError(f"The data is empty; {right}.")
    if n_bytes == _FLOAT32_FILE_SIZE:
        raise MeasurementFormatError(
            f"The data has {n_bytes} bytes, the length of float32 values; {right}, its values being float64."
        )
    raise MeasurementFormatError(f"The data has only {n_bytes} bytes and seems cut off; {right}.")


def check_values(rows: Iterable[Array]) -> Mask:
    """Check the values of a file; return the mask (90, 90, 180) of valid nodes.

    A valid node is above the horizon and not negative in at least one channel. `rows` yields the values at each
    theta_half, shape (16200,): 90 rows of red, then 90 of green and 90 of blue. The check takes 4 MB of memory and one
    row.

    Raises MeasurementFormatError if a value is NaN, infinite or above 1e8/sr, a channel is negative at more than 99 %
    of the nodes above the horizon, or almost all are zero.
    """
    above = nodes_above_horizon().reshape(N_ROWS, ROW_NODES)
    valid, nonzero = np.zeros_like(above), np.zeros_like(above)
    n_measured = [0] * len(CHANNELS)
    not_finite, too_large = _Fault(_NOT_FINITE, "is", "are"), _Fault(_TOO_LARGE, "exceeds", "exceed")
    for number, values in enumerate(rows):
        channel, row = divmod(number, N_ROWS)
        # The warning of NumPy about comparisons with a signalling NaN is off, because NaN is counted as a fault.
        with np.errstate(invalid="ignore"):
            largest, smallest, limit = values.max(), values.min(), MAX_VALUE / SCALE[channel]
            if not (np.isfinite(largest) and np.isfinite(smallest)):
                not_finite.add(channel, row, ~np.isfinite(values))
            # If the largest value is NaN, which has been counted above, this comparison is false.
            if largest > limit:
                too_large.add(channel, row, (values > limit) & above[row])
            measured = (values >= 0.0) & above[row]
            nonzero[row] |= values >= MIN_NONZERO_VALUE / SCALE[channel]
        n_measured[channel] += int(np.count_nonzero(measured))
        valid[row] |= measured
    not_finite.check()
    too_large.check()
    _check_numbers(n_measured, int(np.count_nonzero((valid & nonzero)[1:])), int(above.sum()))
    return valid.reshape(GRID_SHAPE)


def _check_numbers(n_measured: Sequence[int], n_nonzero: int, n_above: int) -> None:
    """Raise MeasurementFormatError if a channel has too few measured nodes, or the file too few nonzero nodes.

    `n_nonzero` excludes the nodes at theta_half = 0, because a bin of zero solid angle is no evidence of a measurement.
    """
    fewest = int(np.argmin(n_measured))
    if n_measured[fewest] < MIN_VALID_FRACTION * n_above:
        raise MeasurementFormatError(
            f"The {CHANNELS[fewest]} channel has valid values (not negative) at {n_measured[fewest]} of the "
            f"{n_above} nodes above the horizon; every channel needs at least {MIN_VALID_FRACTION:.0%}."
        )
    if n_nonzero < MIN_NONZERO_FRACTION * n_above:
        raise MeasurementFormatError(
            f"{n_nonzero} of the {n_above} nodes above the horizon have a value of at least "
            f"{MIN_NONZERO_VALUE:g}/sr at a theta_half above 0; a measurement needs at least "
            f"{MIN_NONZERO_FRACTION:.1%} of the nodes. {_UNIT}"
        )


class _Fault:
    """Count the values that have one kind of fault, and remember the position of the first of these values."""

    def __init__(self, fault: str, verb: str, verb_of_many: str) -> None:
        self._fault, self._verb, self._verb_of_many = fault, verb, verb_of_many
        self._count, self._first = 0, ""

    def add(self, channel: int, row: int, where: Mask) -> None:
        """Count the nodes of a row of theta_half at which the mask `where` is True."""
        found = np.flatnonzero(where)
        if found.size and not self._count:
            node = tuple(int(index) for index in (row, *np.unravel_index(found[0], _ROW_SHAPE)))
            self._first = f"in the {CHANNELS[channel]} channel at (theta_half, theta_diff, phi_diff) node {node}"
        self._count += found.size

    def check(self) -> None:
        """Raise MeasurementFormatError if values have been counted."""
        if self._count == 1:
            raise MeasurementFormatError(f"1 value, {self._first}, {self._verb} {self._fault}")
        if self._count:
            raise MeasurementFormatError(
                f"{self._count} values, the first {self._first}, {self._verb_of_many} {self._fault}"
            )


def checked_values(data: bytes | memoryview) -> tuple[Array, Mask, str]:
    """Check a whole file; return its numbers (3, 90, 90, 180), its mask of valid nodes, and its sha256.

    The numbers are a read-only view of the data. Raises MeasurementFormatError if the file is faulty.
    """
    view = memoryview(data).cast("B")
    check_header(view)
    check_length(len(view))
    stored = np.frombuffer(view, dtype="<f8", offset=HEADER_SIZE)
    valid = check_values(stored.reshape(-1, ROW_NODES))
    valid.flags.writeable = False
    return stored.reshape(SHAPE), valid, hashlib.sha256(view).hexdigest()
