"""Values in 1/sr -> the bytes of a MERL ``.binary`` file."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.data.grid import GRID_SHAPE
from dsbrdf.data.merl_validation import HEADER, SCALE, SHAPE
from dsbrdf.errors import MeasurementFormatError

__all__ = ["encode_stored", "encode_values"]


def encode_values(values: ArrayLike, valid: ArrayLike | None = None) -> Iterator[bytes | memoryview]:
    """Yield the bytes of the file with the given values [1/sr], in pieces.

    Parameters
    ----------
    values : array_like, shape (3, 90, 90, 180)
        The BRDF in 1/sr; negative means no value.
    valid : array_like of bool, shape (90, 90, 180), optional
        Nodes that have a value; the others are stored as -1.

    Raises
    ------
    MeasurementFormatError
        If a shape is wrong or a value is NaN or infinite.
    """
    return encode_stored(_stored(values, valid))


def encode_stored(stored: NDArray[np.float64]) -> Iterator[bytes | memoryview]:
    """Yield the bytes of the file with the given stored numbers, shape (3, 90, 90, 180), in pieces."""
    yield HEADER
    for channel in stored:
        yield np.ascontiguousarray(channel, dtype="<f8").data.cast("B")


def _stored(values: ArrayLike, valid: ArrayLike | None) -> NDArray[np.float64]:
    """Return the numbers to store: values [1/sr] divided by the scale, -1 where there is no value."""
    try:
        brdf = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise MeasurementFormatError(f"The values must be real numbers of the shape {SHAPE}.") from None
    if brdf.shape != SHAPE:
        raise MeasurementFormatError(f"The values have the shape {brdf.shape}; a measurement has {SHAPE}.")
    stored = brdf / SCALE[:, np.newaxis, np.newaxis, np.newaxis]
    if valid is not None:
        mask = np.asarray(valid, dtype=np.bool_)
        if mask.shape != GRID_SHAPE:
            raise MeasurementFormatError(f"The valid nodes have the shape {mask.shape}; it must be {GRID_SHAPE}.")
        stored[:, ~mask] = -1.0
    if not np.isfinite(stored).all():
        count = int((~np.isfinite(stored)).sum())
        are = "is" if count == 1 else "are"
        raise MeasurementFormatError(f"{count} of the values {are} NaN or infinite; every value must be finite.")
    return stored
