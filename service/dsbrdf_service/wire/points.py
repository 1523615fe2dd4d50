"""Points at which a model is evaluated: half and difference angles, or pairs of directions, as text or arrays."""

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from dsbrdf import InvalidArgumentError
from dsbrdf.data.geometry import check_directions, half_difference, spherical
from dsbrdf.engines.engine import OnProgress
from dsbrdf.model.reflectance import ReflectanceModel

from ..errors import ProblemError
from .inputs import AnglesRequest, DirectionsRequest, SidesRequest, parse_document
from .numbers import number_of

Array = NDArray[np.float64]

ANGLES = ("theta_half_deg", "theta_diff_deg")
PHI_DIFF = "phi_diff_deg"
SIDES = ("theta_in_deg", "theta_out_deg")
TURNS = ("phi_in_deg", "phi_out_deg")
DIRECTIONS = ("omega_in", "omega_out")
JSON = "application/json"
NPY = "application/x-npy"
_FORMS: dict[tuple[str, str], tuple[str, ...]] = {ANGLES: (PHI_DIFF,), SIDES: TURNS, DIRECTIONS: ()}
"""Pairs of names by which points are given, and what may be left out beside them."""
_KNOWN = tuple(name for pair, others in _FORMS.items() for name in (*pair, *others))
_LONGEST_NPY_HEADER = 1024
_NPY_SHAPES = ((2,), (3,), (6,), (2, 3))  # of one point
_POINTS = (
    "(n, 2) or (n, 3), theta_half, theta_diff and phi_diff in degrees, or (n, 6) or (n, 2, 3), omega_in and omega_out"
)
_PANORAMA = "(rows, 2 rows, 3), linear RGB of 360 by 180 degrees"
_BELOW_HORIZON = (np.pi / 2, np.pi / 2, 0.0)  # angles of a pair with a direction below the horizon: every model is 0
_CHOICE = f"give {', or '.join(' and '.join(pair) for pair in _FORMS)}, once for each point"
_STARTS_WITH_DIRECTIONS = re.compile(rb'\s*\{\s*"omega_')
_STARTS_WITH_SIDES = re.compile(rb'\s*\{\s*"(theta|phi)_(in|out)_')
MAX_POINTS = 100_000
"""Points of one request."""


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

    def part(self, block: slice) -> "Points":
        """Return some of the points."""
        return Points(self.theta_half[block], self.theta_diff[block], self.phi_diff[block])


def from_query(parameters: Iterable[tuple[str, str]]) -> Points:
    """Return the points of a query, from its names and values; a name occurs once for each point.

    Raises InvalidArgumentError: with one sentence that says what is wrong and what would be right.
    """
    given: dict[str, list[str]] = {}
    for name, text in parameters:
        if name not in _KNOWN:
            raise InvalidArgumentError(f"Unknown query parameter {name[:60]!r}; known are {', '.join(_KNOWN)}.")
        given.setdefault(name, []).append(text)
    pair = _pair(given)
    if pair == DIRECTIONS:
        first, second = ([_vector(name, text) for text in given[name]] for name in pair)
        return from_directions(first, second)
    columns = {name: [_angle(name, text) for text in texts] for name, texts in given.items()}
    return from_angles(**columns) if pair == ANGLES else from_sides(**columns)


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
    return Points(*_broadcast((*ANGLES, PHI_DIFF), [*columns, _turn(PHI_DIFF, phi_diff_deg)]))


def from_sides(
    theta_in_deg: Sequence[float] | Array,
    theta_out_deg: Sequence[float] | Array,
    phi_in_deg: Sequence[float] | Array = (0.0,),
    phi_out_deg: Sequence[float] | Array = (180.0,),
) -> Points:
    """Return the points of both directions' angles in degrees, equally long or of one; phi 0 and 180 are opposite."""
    thetas = [_radians(name, given) for name, given in zip(SIDES, (theta_in_deg, theta_out_deg), strict=True)]
    phis = [_turn(name, given) for name, given in zip(TURNS, (phi_in_deg, phi_out_deg), strict=True)]
    theta_in, theta_out, phi_in, phi_out = _broadcast((*SIDES, *TURNS), [*thetas, *phis])
    return from_directions(spherical(theta_in, phi_in), spherical(theta_out, phi_out))


def from_directions(
    omega_in: Sequence[Sequence[float]] | Array, omega_out: Sequence[Sequence[float]] | Array
) -> Points:
    """Return the points of two sequences of unit vectors, equally long or of one, on either side of the horizon."""
    given = [np.asarray(vectors, dtype=float).reshape(-1, 3) for vectors in (omega_in, omega_out)]
    pairs = zip(DIRECTIONS, _broadcast(DIRECTIONS, given), strict=True)
    first, second = (check_directions(name, vectors, below_horizon=True) for name, vectors in pairs)
    below = np.minimum(first[:, 2], second[:, 2]) < 0.0
    return Points(*np.where(below, np.reshape(_BELOW_HORIZON, (3, 1)), half_difference(first, second)))


def from_json(body: bytes) -> Points:
    """Return the points of a JSON document: an `AnglesRequest`, a `SidesRequest` or a `DirectionsRequest`.

    Raises InvalidArgumentError if it is none of them; the message is about the one that it begins as.
    """
    if _STARTS_WITH_SIDES.match(body):
        return from_sides(**dict(parse_document(SidesRequest, body, strict=True)))
    if _STARTS_WITH_DIRECTIONS.match(body):
        return from_directions(**dict(parse_document(DirectionsRequest, body, strict=True)))
    return from_angles(**dict(parse_document(AnglesRequest, body, strict=True)))


def batch_step(body: bytes, _: OnProgress) -> Points:
    """Return as `from_json`, in a process of its own."""
    return from_json(body)


def from_npy(data: bytes) -> Points:
    """Return the points of a .npy array: (n, 2) or (n, 3) angles in degrees, or (n, 6) or (n, 2, 3) directions.

    Raises InvalidArgumentError if the bytes are not such an array, ProblemError if there are too many points.
    """
    array = read_npy(data, lambda shape: shape[1:] in _NPY_SHAPES, _POINTS)
    check_count(len(array))
    array = array.astype(np.float64)
    if array.shape[1:] in ((2,), (3,)):
        return from_angles(*array.T)
    pairs = array.reshape(-1, 2, 3)
    return from_directions(pairs[:, 0], pairs[:, 1])


def check_count(n_points: int) -> None:
    """Raise ProblemError if one request may not have so many points."""
    if n_points > MAX_POINTS:
        detail = f"{n_points} points are more than the {MAX_POINTS} that one request may have."
        raise ProblemError("too-large", detail)


def panorama_from_npy(data: bytes) -> NDArray[Any]:
    """Return the panorama that a .npy file holds; raise InvalidArgumentError if it holds none."""
    return read_npy(data, lambda shape: len(shape) == 3 and shape[1:] == (2 * shape[0], 3), _PANORAMA)


def read_npy(data: bytes, allowed: Callable[[tuple[int, ...]], bool], wanted: str) -> NDArray[Any]:
    """Return the array of a .npy file, which is not copied, without trusting its header; `wanted` says what it is."""
    stream = BytesIO(data[: _LONGEST_NPY_HEADER + 64])
    try:
        version = npy.read_magic(stream)
        read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        shape, fortran_order, dtype = read(stream, max_header_size=_LONGEST_NPY_HEADER)
    except Exception:  # NumPy parses the header as Python, which can raise any exception
        raise InvalidArgumentError("The body is not a .npy file of version 1.0 or 2.0.") from None
    if dtype.kind != "f" or dtype.itemsize not in (4, 8):
        raise InvalidArgumentError(f"The array holds {dtype}; it must hold float64 or float32.")
    if not allowed(shape) or type(shape[0]) is not int:  # NumPy takes True for a length
        raise InvalidArgumentError(f"The array has the shape {str(shape)[:60]}; it must be {wanted}.")
    expected = math.prod(shape) * dtype.itemsize
    rest = len(data) - stream.tell()
    if min(shape, default=0) < 0 or expected != rest:
        raise InvalidArgumentError(f"The array's header promises {expected} bytes of values, the body has {rest}.")
    flat = np.frombuffer(data, dtype, offset=stream.tell())
    return flat.reshape(shape, order="F" if fortran_order else "C")


def _pair(given: dict[str, list[str]]) -> tuple[str, str]:
    """Return the two names that are given, which have to belong together."""
    for pair, others in _FORMS.items():
        if set(given) - set(others) == set(pair):
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


def _turn(name: str, degrees: Sequence[float] | Array) -> Array:
    angle = np.radians(np.asarray(degrees, dtype=float))
    if not np.isfinite(angle).all():
        raise InvalidArgumentError(f"{name} must be a finite number of degrees.")
    return angle


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
