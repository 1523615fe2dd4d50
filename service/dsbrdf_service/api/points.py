"""Read the points of a request for values: angles or directions, in a query, as JSON or as an array.

All points are converted to half and difference angles.
"""

from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from typing import Annotated, Any, NamedTuple
from urllib.parse import parse_qsl

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from pydantic import Field, ValidationError
from pydantic_core import from_json as parsed

from dsbrdf import InvalidArgumentError
from dsbrdf.data.geometry import check_directions, half_difference, spherical
from dsbrdf.engines.engine import OnProgress

from ..errors import validation_sentence
from .fields import Input

Array = NDArray[np.float64]


def _or_one(schema: dict[str, Any]) -> None:
    """Allow a single item instead of a list in the schema of the list."""
    schema["anyOf"] = [{"type": schema.pop("type"), "items": schema["items"]}, schema.pop("items")]


_Number = Annotated[float, Field(allow_inf_nan=False)]
_Angle = Annotated[float, Field(ge=0, le=90, allow_inf_nan=False)]
_Angles = Annotated[list[_Angle], Field(json_schema_extra=_or_one)]
_Turns = Annotated[list[_Number], Field(json_schema_extra=_or_one)]
_Vectors = Annotated[
    list[Annotated[list[_Number], Field(min_length=3, max_length=3)]],
    Field(description="Unit vectors; values are 0 where one is below the horizon (z < 0)."),
]

_MIRROR_PHI_DIFF_DEG: Any = (90.0,)  # A tuple is used, because pydantic would copy a list for every request.


class AnglesRequest(Input):
    """Points by half and difference angles in degrees; a list with one angle applies to all points."""

    theta_half_deg: Annotated[_Angles, Field(examples=[[10]])]
    theta_diff_deg: Annotated[_Angles, Field(examples=[[30]])]
    phi_diff_deg: _Turns = _MIRROR_PHI_DIFF_DEG
    """90 by default: both directions have equal angles to the normal."""


class SidesRequest(Input):
    """Points by polar and azimuth angles of both directions in degrees; a list with one angle applies to all points."""

    theta_in_deg: _Angles
    theta_out_deg: _Angles
    phi_in_deg: _Turns = [0.0]
    phi_out_deg: _Turns = [180.0]
    """180 by default, the azimuth of the mirror direction."""


class DirectionsRequest(Input):
    """Points by pairs of unit vectors; the surface's normal is (0, 0, 1)."""

    omega_in: _Vectors
    omega_out: _Vectors


_DIRECTIONS = tuple(DirectionsRequest.model_fields)
_MAX_NPY_HEADER_BYTES = 1024
_POINT_SHAPES = ((2,), (3,), (6,), (2, 3))  # Each row of an array of points has one of these shapes.
_ANGLES = "(n, 2) or (n, 3), theta_half, theta_diff and phi_diff in degrees"
_POINTS = f"{_ANGLES}, or (n, 6) or (n, 2, 3), omega_in and omega_out"
_PANORAMA = "(rows, 2 rows, 3), linear RGB of 360 by 180 degrees"
_BELOW_HORIZON = (np.pi / 2, np.pi / 2, 0.0)  # Every model is 0 at these half and difference angles [rad].


class Points(NamedTuple):
    """Half and difference angles, shape (n,) each [rad]."""

    theta_half: Array
    theta_diff: Array
    phi_diff: Array


_CHOICE = "give theta_half_deg and theta_diff_deg, or theta_in_deg and theta_out_deg, or omega_in and omega_out"


def from_query(query: bytes) -> Points:
    """Return the points of a query; a parameter is repeated for several points.

    Raises InvalidArgumentError with one sentence that names the mistake and the remedy.
    """
    given: dict[str, list[Any]] = {}
    for name, text in parse_qsl(query.decode("latin-1"), keep_blank_values=True):
        if "_" in text:  # Python would read 1_0 as the number 10.
            raise InvalidArgumentError(f"{name[:40]} must be a number, not {text[:40]!r}.")
        given.setdefault(name, []).append(text.split(",") if name in _DIRECTIONS else text)
    return _points(given, strict=False)


def from_json(body: bytes) -> Points:
    """Return the points of a JSON document: an `AnglesRequest`, a `SidesRequest` or a `DirectionsRequest`.

    Raises InvalidArgumentError if the document is none of these.
    """
    try:
        given = parsed(body)
    except ValueError as error:
        raise InvalidArgumentError(f"The body is not JSON: {error}.") from None
    if not isinstance(given, dict):
        raise InvalidArgumentError(f"The body must be an object; {_CHOICE}.")
    for name in given.keys() & _FORM_OF:  # The parser would silently keep the last of two members of one name.
        if body.count(b'"%b"' % name.encode()) > 1:
            raise InvalidArgumentError(f"The member {name!r} is given more than once; give it once.")
    several = {name: [value] if isinstance(value, int | float) else value for name, value in given.items()}
    return _points(several, strict=True)


def batch_step(body: bytes, _: OnProgress) -> Points:
    """Parse a JSON document of points in a separate process."""
    return from_json(body)


def from_npy(data: bytes) -> Points:
    """Return the points of a .npy array: (n, 2) or (n, 3) angles in degrees, or (n, 6) or (n, 2, 3) directions.

    Raises InvalidArgumentError if the bytes are not such an array.
    """
    array = read_npy(data, lambda shape: shape[1:] in _POINT_SHAPES, _POINTS).astype(np.float64)
    if array.shape[1:] not in ((2,), (3,)):
        return _of_directions(omega_in=array.reshape(-1, 2, 3)[:, 0], omega_out=array.reshape(-1, 2, 3)[:, 1])
    theta_half, theta_diff, *phi_diff = array.T
    outside = array[:, :2][~((array[:, :2] >= 0.0) & (array[:, :2] <= 90.0))]
    if outside.size:
        detail = f"theta_half and theta_diff must be from 0 to 90 degrees, not {float(outside[0])!r}."
        raise InvalidArgumentError(detail)
    if not np.isfinite(phi_diff).all():
        raise InvalidArgumentError("phi_diff must be a finite number of degrees.")
    return _of_angles(theta_half=theta_half, theta_diff=theta_diff, phi_diff=phi_diff[0] if phi_diff else [90.0])


def panorama_from_npy(data: bytes) -> NDArray[Any]:
    """Return the panorama in a .npy file; raise InvalidArgumentError if the file does not contain a panorama."""
    return read_npy(data, lambda shape: len(shape) == 3 and shape[1:] == (2 * shape[0], 3), _PANORAMA)


def read_npy(data: bytes, allowed: Callable[[tuple[int, ...]], bool], wanted: str) -> NDArray[Any]:
    """Return the array of numbers in a .npy file; `wanted` describes the shapes that are `allowed`."""
    file = BytesIO(data)
    try:
        array: NDArray[Any] = npy.read_array(file, allow_pickle=False, max_header_size=_MAX_NPY_HEADER_BYTES)
    except Exception:  # NumPy parses the header as Python, which can raise any exception.
        raise InvalidArgumentError("The body is not a whole .npy file of numbers.") from None
    if array.dtype.kind != "f" or array.dtype.itemsize not in (4, 8):
        raise InvalidArgumentError(f"The array holds {array.dtype}; it must hold float64 or float32.")
    if not allowed(array.shape):
        raise InvalidArgumentError(f"The array has the shape {array.shape}; it must be {wanted}.")
    if file.tell() != len(data):
        raise InvalidArgumentError("The body has more bytes after the array; send the array alone.")
    return array


def _points(given: Mapping[str, Any], *, strict: bool) -> Points:
    """Return points, read in the form that the first parameter selects; numbers may be texts unless `strict`."""
    form = _FORM_OF.get(next(iter(given), ""))
    if form is None:
        fault = f"{next(iter(given))[:60]!r} does not belong to a point" if given else "The request has no point"
        raise InvalidArgumentError(f"{fault}; {_CHOICE}.")
    try:
        return _READ[form](**vars(form.model_validate(given, strict=strict)))
    except ValidationError as error:
        raise InvalidArgumentError(validation_sentence(error.errors(), form.model_fields)) from None


def _of_angles(**degrees: Any) -> Points:
    return Points(*np.radians(_broadcast(degrees)))


def _of_sides(**degrees: Any) -> Points:
    theta_in, theta_out, phi_in, phi_out = np.radians(_broadcast(degrees))
    return _of_directions(omega_in=spherical(theta_in, phi_in), omega_out=spherical(theta_out, phi_out))


def _of_directions(**omega: Any) -> Points:
    """Return the points of unit vectors, which may be below the horizon."""
    given = {name: np.asarray(vectors, dtype=float).reshape(-1, 3) for name, vectors in omega.items()}
    named = zip(given, _broadcast(given), strict=True)
    first, second = (check_directions(name, vectors, below_horizon=True) for name, vectors in named)
    below = np.minimum(first[:, 2], second[:, 2]) < 0.0
    return Points(*np.where(below, np.reshape(_BELOW_HORIZON, (3, 1)), half_difference(first, second)))


def _broadcast(columns: Mapping[str, Any]) -> Sequence[Any]:
    """Return columns of equal length; a column of one value is repeated for all points."""
    counts = set(map(len, columns.values()))
    if len(counts) == 1:
        return list(columns.values())
    several = counts - {1}
    if len(several) > 1:
        parts = " and ".join(f"{len(column)} values of {name}" for name, column in columns.items() if len(column) != 1)
        raise InvalidArgumentError(f"There are {parts}; give equally many of each, or one for all points.")
    arrays = [np.asarray(column, dtype=float) for column in columns.values()]
    return [np.broadcast_to(array, (*several, *array.shape[1:])) for array in arrays]


_READ: dict[type[Input], Callable[..., Points]] = {
    AnglesRequest: _of_angles,
    SidesRequest: _of_sides,
    DirectionsRequest: _of_directions,
}
FORMS = tuple(_READ)
"""Pydantic models of documents of points."""
_FORM_OF = {name: form for form in FORMS for name in form.model_fields}
