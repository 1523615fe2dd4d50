"""Points at which a model is evaluated: half and difference angles, or pairs of directions, as text or arrays.

Many points are kept in a temporary file.
"""

import math
import mmap
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, TypeVar

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from pydantic_core import from_json

from dsbrdf import InvalidArgumentError
from dsbrdf.data.geometry import check_directions, half_difference
from dsbrdf.model.reflectance import ReflectanceModel

T = TypeVar("T")
Array = NDArray[np.float64]

ANGLES = ("theta_half_deg", "theta_diff_deg")
PHI_DIFF = "phi_diff_deg"
DIRECTIONS = ("omega_in", "omega_out")
JSON = "application/json"
NPY = "application/x-npy"
_KNOWN = (*ANGLES, PHI_DIFF, *DIRECTIONS)
_LONGEST_NPY_HEADER = 1024
_NPY_SHAPES = ((2,), (3,), (6,), (2, 3))  # of one point
_BELOW_HORIZON = (np.pi / 2, np.pi / 2, 0.0)  # angles of a pair with a direction below the horizon: every model is 0
_CHOICE = f"give {' and '.join(ANGLES)}, or {' and '.join(DIRECTIONS)}, once for each point"
_LIST = re.compile(rb'"(\w+)"\s*:\s*\[')
_OF_NUMBERS = b"0123456789eE+-.,[] \t\r\n"
_PIECE = 1 << 15  # bytes of JSON that are read while no other thread runs
BLOCK = 4096  # points: what is kept of a long answer that nobody reads is a few blocks


@dataclass(frozen=True)
class Points:
    """Half and difference angles, shape (n,) each [rad]."""

    theta_half: Array
    theta_diff: Array
    phi_diff: Array

    def __len__(self) -> int:
        return len(self.theta_half)

    def values(self, model: ReflectanceModel) -> Array:
        """Return the model's values, shape (n, 3) [1/sr]; 0 where a direction is below the horizon."""
        return model.evaluate(self.theta_half, self.theta_diff, self.phi_diff)

    def blocks(self) -> "Iterator[Points]":
        """Yield the points in blocks; there is one, even if it is empty."""
        for start in range(0, max(len(self), 1), BLOCK):
            block = slice(start, start + BLOCK)
            yield Points(self.theta_half[block], self.theta_diff[block], self.phi_diff[block])


def kept(blocks: Iterator[Points], folder: Path) -> Points:
    """Return the points of all blocks; more than one block in a temporary file in `folder`, which goes with them."""
    first = next(blocks)
    if len(first) < BLOCK:
        return first
    with TemporaryFile(dir=folder) as file:
        for block in chain((first,), blocks):
            file.write(np.stack([block.theta_half, block.theta_diff, block.phi_diff], axis=1).tobytes())
        file.flush()
        columns = np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)).reshape(-1, 3).T
    return Points(*columns)


def from_query(parameters: Iterable[tuple[str, str]]) -> Points:
    """Return the points of a query's names and values, which repeat for several points.

    Raises InvalidArgumentError: with one sentence that says what is wrong and what would be right.
    """
    given: dict[str, list[str]] = {}
    for name, text in parameters:
        if name not in _KNOWN:
            raise InvalidArgumentError(f"Unknown query parameter {name[:60]!r}; known are {', '.join(_KNOWN)}.")
        given.setdefault(name, []).append(text)
    first, second = _pair(given)
    if first == ANGLES[0]:
        columns = ([_angle(name, text) for text in given[name]] for name in (first, second, PHI_DIFF) if name in given)
        return from_angles(*columns)
    return from_directions([_vector(first, t) for t in given[first]], [_vector(second, t) for t in given[second]])


def from_angles(
    theta_half_deg: Sequence[float] | Array,
    theta_diff_deg: Sequence[float] | Array,
    phi_diff_deg: Sequence[float] | Array | None = None,
) -> Points:
    """Return the points of sequences of angles in degrees, equally long or of one; phi_diff is 90 where left out."""
    columns = [_radians(ANGLES[0], theta_half_deg), _radians(ANGLES[1], theta_diff_deg)]
    if phi_diff_deg is None:
        theta_half, theta_diff = _broadcast(ANGLES, columns)
        return Points(theta_half, theta_diff, np.full(len(theta_half), np.pi / 2))
    phi_diff = np.radians(np.asarray(phi_diff_deg, dtype=float))
    if not np.isfinite(phi_diff).all():
        raise InvalidArgumentError(f"{PHI_DIFF} must be a finite number of degrees.")
    return Points(*_broadcast((*ANGLES, PHI_DIFF), [*columns, phi_diff]))


def from_directions(
    omega_in: Sequence[Sequence[float]] | Array, omega_out: Sequence[Sequence[float]] | Array
) -> Points:
    """Return the points of two sequences of unit vectors, equally long or of one, on either side of the horizon."""
    given = [np.asarray(vectors, dtype=float).reshape(-1, 3) for vectors in (omega_in, omega_out)]
    pairs = _broadcast(DIRECTIONS, given)
    angles = np.empty((3, len(pairs[0])))
    for start in range(0, len(pairs[0]), BLOCK):
        block = slice(start, start + BLOCK)
        first, second = (
            check_directions(name, part[block], below_horizon=True)
            for name, part in zip(DIRECTIONS, pairs, strict=True)
        )
        below = np.minimum(first[:, 2], second[:, 2]) < 0.0
        angles[:, block] = np.where(below, np.reshape(_BELOW_HORIZON, (3, 1)), half_difference(first, second))
    return Points(*angles)


def take_lists(body: bytes, n_dimensions: int) -> tuple[bytes, dict[str, Array]]:
    """Return a JSON document with empty lists in place of its members' lists of numbers, and these lists.

    A list is read piece by piece: while one is, no other thread runs, the one that answers requests neither. A document
    with anything but such lists, of numbers or of three each by `n_dimensions`, is returned as it is.
    """
    rest, taken, begin = b"", dict[str, Array](), 0
    while (quote := body.find(b'"', begin)) >= 0:
        member, after = _LIST.match(body, quote), body.find(b'"', body.find(b"[", quote))
        end = body.rfind(b"]", quote, after if after >= 0 else len(body))
        try:
            numbers = None if member is None else _numbers(body[member.end() : end], n_dimensions)
        except (ValueError, OverflowError):
            numbers = None
        if member is None or numbers is None:
            return body, {}
        taken[member[1].decode()] = numbers
        rest += body[begin : member.end()]
        begin = end
    return rest + body[begin:], taken


def _numbers(text: bytes, n_dimensions: int) -> Array | None:
    """Return the numbers of a list without its brackets; None if there is anything else, or nothing, in it."""
    between = b"," if n_dimensions == 1 else b"],"
    parts, begin = [], 0
    while begin <= len(text):
        cut = text.find(between, begin + _PIECE)
        end = len(text) if cut < 0 else cut + len(between) - 1
        piece = text[begin:end]
        if piece.translate(None, _OF_NUMBERS):
            return None
        part = np.array(from_json(b"[%b]" % piece), dtype=float)
        if part.shape != (len(part), 3)[:n_dimensions] or not part.size:
            return None
        parts.append(part)
        begin = end + 1
    numbers = np.concatenate(parts)
    return numbers if np.isfinite(numbers).all() else None


def npy_blocks(data: bytes | mmap.mmap) -> Iterator[Points]:
    """Yield the points of a .npy array in blocks.

    It has (n, 2) or (n, 3) angles in degrees, or (n, 6) or (n, 2, 3) directions.

    Raises InvalidArgumentError if the bytes are not such an array.
    """
    array = _read_npy(data)
    for start in range(0, max(len(array), 1), BLOCK):
        block = array[start : start + BLOCK].astype(np.float64)
        if array.shape[1:] in ((2,), (3,)):
            yield from_angles(*block.T)
        else:
            pairs = block.reshape(-1, 2, 3)
            yield from_directions(pairs[:, 0], pairs[:, 1])


def _read_npy(data: bytes | mmap.mmap) -> NDArray[Any]:
    """Return the array of a .npy file, which is not copied, without trusting its header."""
    stream = BytesIO(data[: _LONGEST_NPY_HEADER + 64])
    try:
        version = npy.read_magic(stream)
        read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        shape, fortran_order, dtype = read(stream, max_header_size=_LONGEST_NPY_HEADER)
    except Exception:  # NumPy parses the header as Python, which can raise any exception
        raise InvalidArgumentError("The body is not a .npy file of version 1.0 or 2.0.") from None
    if dtype.kind != "f" or dtype.itemsize not in (4, 8):
        raise InvalidArgumentError(f"The array holds {dtype}; it must hold float64 or float32.")
    if shape[1:] not in _NPY_SHAPES:
        raise InvalidArgumentError(
            f"The array has the shape {str(shape)[:60]}; it must be (n, 2) or (n, 3), theta_half, theta_diff and "
            "phi_diff in degrees, or (n, 6) or (n, 2, 3), omega_in and omega_out."
        )
    expected = math.prod(shape) * dtype.itemsize
    rest = len(data) - stream.tell()
    if min(shape, default=0) < 0 or expected != rest:
        raise InvalidArgumentError(f"The array's header promises {expected} bytes of values, the body has {rest}.")
    flat = np.frombuffer(data, dtype, offset=stream.tell())
    return flat.reshape(shape, order="F" if fortran_order else "C")


def _pair(given: dict[str, list[str]]) -> tuple[str, str]:
    """Return the two names that are given, which have to belong together."""
    for pair in (ANGLES, DIRECTIONS):
        if set(given) - ({PHI_DIFF} if pair == ANGLES else set()) == set(pair):
            return pair
    fault = f"has {' and '.join(given)}" if given else "names no point"
    raise InvalidArgumentError(f"The query {fault}; {_CHOICE}.")


def _broadcast(names: Sequence[str], columns: Sequence[Array]) -> Sequence[Array]:
    """Return columns of one length; a column of one value counts for all points."""
    counts = [len(column) for column in columns]
    if min(counts) == max(counts):
        return columns
    if not set(counts) <= {1, max(counts)}:
        parts = [f"{count} values of {name}" for name, count in zip(names, counts, strict=True) if count != 1]
        raise InvalidArgumentError(f"There are {' and '.join(parts)}; give as many of each, or one for all.")
    return [np.broadcast_to(column, (max(counts), *column.shape[1:])) for column in columns]


def _radians(name: str, degrees: Sequence[float] | Array) -> Array:
    angle = np.asarray(degrees, dtype=float)
    inside = (angle >= 0.0) & (angle <= 90.0)
    if not inside.all():
        worst = angle[~inside][0]
        raise InvalidArgumentError(f"{name} must be a number of degrees from 0 to 90, not {float(worst)!r}.")
    return np.radians(angle)


def _angle(name: str, text: str) -> float:
    try:
        return number_of(text)
    except ValueError:
        raise InvalidArgumentError(f"{name} must be a number of degrees, not {text[:40]!r}.") from None


def _vector(name: str, text: str) -> list[float]:
    try:
        x, y, z = (number_of(part) for part in text.split(","))
    except ValueError:
        raise InvalidArgumentError(f"{name} must be three numbers x,y,z, not {text[:60]!r}.") from None
    return [x, y, z]


def number_of(text: str) -> float:
    """Return the number that a text is; raise ValueError if only Python takes it for one, such as ``1_0``."""
    return float(check_plain(text))


def check_plain(text: T) -> T:
    """Return what is given; raise ValueError if it is a text that only Python takes for a number."""
    if isinstance(text, str) and ("_" in text or not text.isascii()):
        raise ValueError(f"{text[:40]!r} is no number")
    return text
