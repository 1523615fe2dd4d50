"""Light from all around a sphere: what shines, and the integral over it for every pixel.

    radiance(normal) = integral f(omega_in, view) L(omega_in) cos(theta_in) d omega_in,
    d omega_in = 4 cos(theta_diff) d omega_half,

is taken over half vectors, with nodes that crowd towards theta_half = 0 about each normal, where a narrow lobe is.

The material is isotropic: normals at one angle to the view, a ring of the sphere, see the same angles, and from normal
to normal only the environment turns about the view.  So f is evaluated for one normal of each ring, the weighted values
are spread over a map of directions in polar coordinates about the view, and the radiance of the whole ring is the
circular correlation of that map with the environment's.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.fft import irfft, rfft

from dsbrdf.data.geometry import half_difference

__all__ = ["EnvironmentRings", "environment_radiance", "environment_rings"]

Array = NDArray[np.float64]
Evaluate = Callable[[Array, Array, Array], Array]

_SPACING = np.radians(3.5)
"""Distance of the nodes in half vectors; with the widths below, an image agrees with that of finer nodes to 57 dB."""
_FEWEST_AZIMUTHS = 8


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


@dataclass(frozen=True, eq=False)
class EnvironmentRings:
    """What the image under the environment is made of: R rings, a map of P polar angles by A azimuths.

    Attributes
    ----------
    angles : tuple of ndarray, shape (M,)
        theta_half, theta_diff and phi_diff of all nodes of all rings.
    spread : sparse array, shape (R * P * A, M)
        Weights of the values at the nodes in the map of directions of each ring.
    harmonics : ndarray, shape (3, P, A // 2 + 1)
        Fourier series of the environment over the azimuth.
    to_pixels : sparse array, shape (N, R * A)
        Bilinear interpolation from rings to pixels.
    """

    angles: tuple[Array, Array, Array]
    spread: sparse.csr_array
    harmonics: NDArray[np.complex128]
    to_pixels: sparse.csr_array

    def radiance(self, evaluate: Evaluate) -> Array:
        """Radiance of the N pixels, shape (N, 3), of a function of the three angles."""
        values = evaluate(*self.angles)
        polar, modes = self.harmonics.shape[1:]
        azimuths = 2 * (modes - 1)
        pixels = np.empty((self.to_pixels.shape[0], 3))
        for channel, harmonics in enumerate(self.harmonics):
            maps = (self.spread @ values[:, channel]).reshape(-1, polar, azimuths)
            series = np.einsum("rpm,pm->rm", rfft(maps, axis=-1).conj(), harmonics)
            pixels[:, channel] = self.to_pixels @ irfft(series, azimuths, axis=-1).ravel()
        return pixels


def environment_rings(normals: Array, size: int) -> EnvironmentRings:
    """Prepare the image of normals on a sphere.

    Parameters
    ----------
    normals : ndarray, shape (N, 3)
        Unit vectors with z > 0, one for each pixel.
    size : int
        Pixels along a side of the image: the finer the image, the finer the rings.

    Returns
    -------
    EnvironmentRings
    """
    azimuths = 128 if size <= 64 else 256
    shape = azimuths // 2 + 1, azimuths
    tilt = np.arctan2(np.hypot(normals[:, 0], normals[:, 1]), normals[:, 2])
    rings = np.linspace(0.0, tilt.max(), 3 * size // 4)
    nodes = [_ring_nodes(theta) for theta in rings]
    ring = np.repeat(np.arange(rings.size), [node.shape[1] for node in nodes])
    theta_half, theta_diff, phi_diff, azimuth, weight = np.concatenate(nodes, axis=1)
    # Twice theta_diff is the angle between light and view.
    cells, shares = _bilinear(2.0 * theta_diff * (shape[0] - 1) / np.pi, azimuth * shape[1] / (2.0 * np.pi), shape)
    points = np.broadcast_to(np.arange(ring.size), cells.shape)
    cells = cells + ring * shape[0] * shape[1]
    spread = sparse.csr_array(
        ((shares * weight).ravel(), (cells.ravel(), points.ravel())), (rings.size * shape[0] * shape[1], ring.size)
    )
    position = tilt / rings[-1] * (rings.size - 1), np.arctan2(normals[:, 1], normals[:, 0]) * shape[1] / (2.0 * np.pi)
    cells, shares = _bilinear(*position, (rings.size, shape[1]))
    pixels = np.broadcast_to(np.arange(len(normals)), cells.shape)
    to_pixels = sparse.csr_array(
        (shares.ravel(), (pixels.ravel(), cells.ravel())), (len(normals), rings.size * shape[1])
    )
    return EnvironmentRings((theta_half, theta_diff, phi_diff), spread, _harmonics(shape), to_pixels)


def _harmonics(shape: tuple[int, int]) -> NDArray[np.complex128]:
    """Fourier series of the environment over the azimuth about the view, shape (3, P, A // 2 + 1)."""
    polar = np.linspace(0.0, np.pi, shape[0])[:, np.newaxis]
    azimuth = np.arange(shape[1]) * 2.0 * np.pi / shape[1]
    direction = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0.0 * azimuth]
    radiance = environment_radiance(np.stack(direction, axis=-1))
    return np.asarray(rfft(np.moveaxis(radiance, -1, 0), axis=-1))


def _ring_nodes(tilt: float) -> Array:
    """Nodes of the integral for the normal (sin(tilt), 0, cos(tilt)).

    Returns
    -------
    ndarray, shape (5, nodes)
        theta_half, theta_diff, phi_diff, azimuth of omega_in about the view, and weight, which holds the cosine and
        the solid angle.
    """
    largest = 0.5 * (np.pi / 2 + tilt)  # theta_half at which omega_in is at the horizon for every azimuth
    count = int(np.ceil(2.0 * largest / _SPACING))
    s = (np.arange(count) + 0.5) / count
    theta_half, step = largest * s * s, largest * 2.0 * s / count  # crowded towards 0
    last = _last_azimuth(theta_half, tilt)
    number = np.maximum(np.ceil(2.0 * last * np.sin(theta_half) / _SPACING), _FEWEST_AZIMUTHS).astype(np.intp)
    row = np.repeat(np.arange(count), number)
    within = np.arange(row.size) - np.repeat(np.cumsum(number) - number, number)
    around = last[row] * (2.0 * (within + 0.5) / number[row] - 1.0)
    theta_half, area = theta_half[row], (step * np.sin(theta_half) * 2.0 * last / number)[row]

    sin_tilt, cos_tilt = np.sin(tilt), np.cos(tilt)
    # In the frame with the normal as z axis and the view in the half plane y = 0, x >= 0.
    half = np.stack(
        [np.sin(theta_half) * np.cos(around), np.sin(theta_half) * np.sin(around), np.cos(theta_half)], axis=-1
    )
    omega_out = np.array([sin_tilt, 0.0, cos_tilt])
    cos_diff = half @ omega_out
    omega_in = 2.0 * cos_diff[:, np.newaxis] * half - omega_out
    _, theta_diff, phi_diff = half_difference(omega_in, omega_out)
    # The world's x axis is the direction in which the normal is tilted.
    world_x = sin_tilt * omega_in[:, 2] - cos_tilt * omega_in[:, 0]
    azimuth = np.arctan2(-omega_in[:, 1], world_x)
    weight = 4.0 * cos_diff * np.maximum(omega_in[:, 2], 0.0) * area
    return np.stack([theta_half, theta_diff, phi_diff, azimuth, weight])


def _last_azimuth(theta_half: Array, tilt: float) -> Array:
    """Largest azimuth of the half vector from the view at which omega_in is above the horizon."""
    down = np.cos(tilt) * np.cos(2.0 * theta_half)
    across = np.sin(tilt) * np.sin(2.0 * theta_half)
    ratio = np.where(across > np.abs(down), down / np.where(across > 0.0, across, 1.0), np.sign(down))
    return np.asarray(np.arccos(np.clip(-ratio, -1.0, 1.0)))


def _bilinear(row: Array, column: Array, shape: tuple[int, int]) -> tuple[NDArray[np.intp], Array]:
    """Flat indices and weights of the four neighbours of each point, shapes (4, N); the columns are periodic."""
    low = np.clip(row.astype(np.intp), 0, shape[0] - 2)
    left = np.floor(column).astype(np.intp)
    down, right = row - low, column - left
    cells = [(low + i) * shape[1] + (left + j) % shape[1] for i in (0, 1) for j in (0, 1)]
    shares = [(down if i else 1.0 - down) * (right if j else 1.0 - right) for i in (0, 1) for j in (0, 1)]
    return np.array(cells), np.array(shares)
