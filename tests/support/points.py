"""Batches of points as clients send them."""

import io

import numpy as np
from numpy.typing import ArrayLike


def npy(array: ArrayLike) -> bytes:
    """Return an array as the content of a .npy file."""
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(array))
    return buffer.getvalue()
