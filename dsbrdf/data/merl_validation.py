"""Check a MERL ``.binary`` file piece by piece, while it arrives.

The header is checked before the length, and the length before the values, so that the error message of a file does not
depend on the sizes of the pieces. `dsbrdf.data.merl` describes the format.
"""

import hashlib
import struct

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.files import known_kind
from dsbrdf.data.grid import CHANNELS, GRID_SHAPE, nodes_above_horizon
from dsbrdf.errors import MeasurementFormatError

HEADER = struct.pack("<3i", *GRID_SHAPE)
HEADER_SIZE = len(HEADER)
NODES = 90 * 90 * 180
FILE_SIZE = HEADER_SIZE + 3 * NODES * 8
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
SCALE.flags.writeable = False
MAX_VALUE = 1e8  # A file with a larger value is refused, because no BRDF is so large [1/sr].
MIN_NONZERO_VALUE = 1e-8  # Smaller values count as zero, because every real material is brighter [1/sr].
MIN_VALID_FRACTION = 0.01  # A channel with a smaller fraction of valid nodes is refused.
MIN_NONZERO_FRACTION = 0.001  # A file with a smaller fraction of nonzero nodes is refused, because they are noise.

_FLOAT32_FILE_SIZE = HEADER_SIZE + 3 * NODES * 4
SHAPE = (len(CHANNELS), *GRID_SHAPE)
_PIECE_BYTES = 1 << 20
_AXES = ("theta_half", "theta_diff", "phi_diff")
_MAX_LIKELY_SIZE = 100_000  # Larger numbers are not the dimensions of a grid: the file is of another kind.
_NOT_FINITE = "NaN or infinite; every value must be finite."
_UNIT = "Stored values are the BRDF in 1/sr times 1500 / (1, 1.15, 1.66)."
_TOO_LARGE = f"1e8/sr, which no reflectance has. {_UNIT}"


def check_header(header: bytes | bytearray | memoryview) -> None:
    """Raise MeasurementFormatError unless the first 12 bytes of a file are the dimensions of the MERL grid."""
    start = bytes(header[:HEADER_SIZE])
    if (kind := known_kind(start)) is not None:
        raise MeasurementFormatError(f"The data is {kind}; a MERL measurement is a .binary file of {FILE_SIZE} bytes.")
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
        raise MeasurementFormatError(_other_kind(start))
    wrong = [
        f"{axis} is {size} and not {expected}"
        for axis, size, expected in zip(_AXES, found, GRID_SHAPE, strict=True)
        if size != expected
    ]
    raise MeasurementFormatError(f"The dimensions in the header are {found}: {', '.join(wrong)}; {right}.")


def _other_kind(start: bytes) -> str:
    """Return an error message for a file that is a text or of an unknown kind."""
    text = start.decode("utf-8", "ignore")
    if len(text) > HEADER_SIZE - 4 and all(letter.isprintable() or letter.isspace() for letter in text):
        return f"The data is a text that begins with {text.split(chr(10))[0]!r}, and no MERL measurement."
    return f"The data is no MERL measurement, which begins with the dimensions {GRID_SHAPE}."


def check_length(n_bytes: int) -> None:
    """Raise MeasurementFormatError unless a whole file, header included, has `FILE_SIZE` bytes."""
    if n_bytes == FILE_SIZE:
        return
    right = f"a MERL measurement has exactly {FILE_SIZE} bytes (12 + 3 x 90 x 90 x 180 x 8)"
    if n_bytes > FILE_SIZE:
        # The message has no length: during an upload, the length is not known yet.
        raise MeasurementFormatError(f"The data is longer than {FILE_SIZE} bytes; {right}.")
    if n_bytes == 0:
        raise MeasurementFormatError(f"The data is empty; {right}.")
    if n_bytes == _FLOAT32_FILE_SIZE:
        raise MeasurementFormatError(
            f"The data has {n_bytes} bytes, the length of float32 values; {right}, its values being float64."
        )
    raise MeasurementFormatError(f"The data has only {n_bytes} bytes and seems cut off; {right}.")


class MerlChecker:
    """Check the bytes of a MERL file piece by piece, in bounded memory.

    Pass all bytes in order to `update`, then call `finish`. The checker stores only two bits per node, 0.4 MB, so that
    many uploads can be checked at the same time. `n_bytes` is the number of bytes so far.
    """

    def __init__(self) -> None:
        self.n_bytes = 0
        self._header = b""
        # The last bytes of a piece that do not fill a group of eight values; eight values fill a byte of bits.
        self._rest = b""
        self._n_values = 0
        # Bits of the nodes at which a channel is not negative, and at which a channel is at least `MIN_NONZERO_VALUE`.
        self._measured = np.zeros(NODES // 8, dtype=np.uint8)
        self._nonzero = np.zeros(NODES // 8, dtype=np.uint8)
        # For each channel, the number of nodes above the horizon that are not negative.
        self._n_measured = [0] * len(CHANNELS)
        self._above = nodes_above_horizon().reshape(-1)
        # For each fault, the number of faulty values and the position of the first one.
        self._faults: dict[str, tuple[int, str]] = {}

    def update(self, piece: bytes | bytearray | memoryview) -> None:
        """Check the next bytes, of any length.

        Raises MeasurementFormatError as soon as the header is wrong or there are too many bytes. `finish` reports wrong
        values, because the message contains their number.
        """
        view = memoryview(piece).cast("B")
        self.n_bytes += len(view)
        if len(self._header) < HEADER_SIZE:
            taken = HEADER_SIZE - len(self._header)
            self._header += bytes(view[:taken])
            view = view[taken:]
            if len(self._header) == HEADER_SIZE:
                check_header(self._header)
        if self.n_bytes > FILE_SIZE:
            check_length(self.n_bytes)
        if self._rest:
            view = memoryview(self._rest + bytes(view))
        whole = len(view) // 64 * 64
        self._check_values(np.frombuffer(view[:whole], dtype="<f8"))
        self._rest = bytes(view[whole:])

    def finish(self) -> Mask:
        """Return the mask (90, 90, 180) of valid nodes: above the horizon and not negative in at least one channel.

        Call it after the last byte. Raises MeasurementFormatError if the length is wrong, a value is NaN, infinite or
        above 1e8/sr, a channel is negative at more than 99 % of the nodes above the horizon, or almost all are zero.
        """
        # `update` checks the header only if it is complete.
        check_header(self._header)
        check_length(self.n_bytes)
        for fault, (verb, verb_of_many) in (_NOT_FINITE, ("is", "are")), (_TOO_LARGE, ("exceeds", "exceed")):
            count, first = self._faults.get(fault, (0, ""))
            if count:
                said = (
                    f"1 value, {first}, {verb}" if count == 1 else f"{count} values, the first {first}, {verb_of_many}"
                )
                raise MeasurementFormatError(f"{said} {fault}")
        valid = np.unpackbits(self._measured).view(np.bool_)
        valid &= self._above
        n_above = int(self._above.sum())
        fewest = int(np.argmin(self._n_measured))
        if self._n_measured[fewest] < MIN_VALID_FRACTION * n_above:
            raise MeasurementFormatError(
                f"The {CHANNELS[fewest]} channel has valid values (not negative) at {self._n_measured[fewest]} of the "
                f"{n_above} nodes above the horizon; every channel needs at least {MIN_VALID_FRACTION:.0%}."
            )
        # Nodes at theta_half = 0 do not count, because they have no solid angle.
        n_nonzero = int(np.bitwise_count(np.packbits(valid) & self._nonzero)[NODES // 90 // 8 :].sum())
        if n_nonzero < MIN_NONZERO_FRACTION * n_above:
            raise MeasurementFormatError(
                f"{n_nonzero} of the {n_above} nodes above the horizon have a value of at least "
                f"{MIN_NONZERO_VALUE:g}/sr at a theta_half above 0; a measurement needs at least "
                f"{MIN_NONZERO_FRACTION:.1%} of the nodes. {_UNIT}"
            )
        return valid.reshape(GRID_SHAPE)

    def _check_values(self, values: Array) -> None:
        """Check consecutive values, a multiple of eight; they may begin in one channel and end in another."""
        while values.size:
            channel, node = divmod(self._n_values, NODES)
            part, values = values[: NODES - node], values[NODES - node :]
            self._n_values += part.size
            nodes, octets = slice(node, node + part.size), slice(node // 8, (node + part.size) // 8)
            # NumPy would warn about comparisons with signalling NaN.
            with np.errstate(invalid="ignore"):
                largest, smallest, limit = part.max(), part.min(), MAX_VALUE / SCALE[channel]
                if not (np.isfinite(largest) and np.isfinite(smallest)):
                    self._record(_NOT_FINITE, ~np.isfinite(part), channel, node)
                # This is false if the maximum is NaN, which has been recorded above.
                if largest > limit:
                    self._record(_TOO_LARGE, (part > limit) & self._above[nodes], channel, node)
                measured = part >= 0.0
                self._n_measured[channel] += int(np.count_nonzero(measured & self._above[nodes]))
                self._measured[octets] |= np.packbits(measured)
                self._nonzero[octets] |= np.packbits(part >= MIN_NONZERO_VALUE / SCALE[channel])

    def _record(self, fault: str, where: Mask, channel: int, start: int) -> None:
        found = np.flatnonzero(where)
        if found.size:
            node = tuple(int(index) for index in np.unravel_index(start + found[0], GRID_SHAPE))
            place = f"in the {CHANNELS[channel]} channel at (theta_half, theta_diff, phi_diff) node {node}"
            count, first = self._faults.get(fault, (0, place))
            self._faults[fault] = count + found.size, first


def checked_values(data: bytes | memoryview) -> tuple[Array, Mask, str]:
    """Check a whole file; return its numbers (3, 90, 90, 180), its mask of valid nodes, and its sha256.

    The numbers are a read-only view of the data. Raises MeasurementFormatError if the file is faulty.
    """
    view = memoryview(data).cast("B")
    checker, digest = MerlChecker(), hashlib.sha256()
    for start in range(0, len(view), _PIECE_BYTES):
        piece = view[start : start + _PIECE_BYTES]
        checker.update(piece)
        digest.update(piece)
    valid = checker.finish()
    valid.flags.writeable = False
    stored = np.frombuffer(view, dtype="<f8", offset=HEADER_SIZE).reshape(SHAPE)
    return stored, valid, digest.hexdigest()
