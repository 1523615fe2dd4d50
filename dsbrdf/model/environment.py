"""What shines from all around a sphere: a sky with a window above a ground, or a picture that the user gives.

The view looks along -z; x is to the right and y up.
"""

import numpy as np
from numpy.typing import NDArray

__all__ = ["environment_radiance"]

Array = NDArray[np.float64]


def _unit(x: float, y: float, z: float) -> Array:
    return np.array([x, y, z]) / np.sqrt(x * x + y * y + z * z)


def _axes(towards: Array) -> Array:
    """Unit vectors to the right, up and along a direction that is looked in, in rows."""
    across = np.cross(towards, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(across, towards), towards])


# Nothing here is narrower than the nodes of the integral are apart: widths and edges are in radians or slopes.
_ZENITH, _HORIZON, _GROUND = np.array([0.25, 0.45, 0.9]), np.array([0.9, 0.95, 1.0]), np.array([0.22, 0.19, 0.16])
_HORIZON_WIDTH = 0.02
_WINDOW, _WINDOW_AXES = np.array([3.0, 3.0, 3.0]), _axes(_unit(0.87, 0.13, 0.5))
_WINDOW_HALF_SIZE, _WINDOW_EDGE = np.array([0.35, 0.5]), 0.02


def environment_radiance(direction: Array) -> Array:
    """Radiance of the environment without its sun: a sky above a ground, and a window.

    Parameters
    ----------
    direction : ndarray, shape (..., 3)
        Unit vectors towards the light; y is up.

    Returns
    -------
    ndarray, shape (..., 3)
        Linear RGB.
    """
    up = direction[..., 1]
    sky = _HORIZON + (_ZENITH - _HORIZON) * np.clip(up, 0.0, 1.0)[..., np.newaxis] ** 0.6
    above = _logistic(up / _HORIZON_WIDTH)
    radiance = above * sky + (1.0 - above) * _GROUND
    # The window is a rectangle on the plane at distance 1, at right angles to its direction.
    across, upward, along = np.moveaxis(direction @ _WINDOW_AXES.T, -1, 0)
    ahead = np.maximum(along, 1e-3)
    window = np.where(along > 0.0, 1.0, 0.0)[..., np.newaxis]
    for position, half in zip((across / ahead, upward / ahead), _WINDOW_HALF_SIZE, strict=True):
        window = window * _logistic((half - np.abs(position)) / _WINDOW_EDGE)
    return radiance + window * _WINDOW


def _logistic(x: Array) -> Array:
    """Soft step from 0 to 1, with an axis for the channels."""
    return (0.5 + 0.5 * np.tanh(0.5 * x))[..., np.newaxis]
