"""Convert between directions and half and difference angles, and define the angular grid of the MERL database.

Let ``omega_in`` and ``omega_out`` be unit vectors above a surface with the normal (0, 0, 1). The half vector ``h`` is
proportional to ``omega_in + omega_out`` and has the polar angles ``theta_half`` and ``phi_half``. In the frame whose
pole is ``h``, ``omega_in`` has the polar angles ``theta_diff`` and ``phi_diff``. The directions are, with ``s = +1``
for ``omega_in`` and ``s = -1`` for ``omega_out``::

    Rz(phi_half) Ry(theta_half) (s sin(theta_diff) cos(phi_diff),
                                 s sin(theta_diff) sin(phi_diff),
                                 cos(theta_diff))

An isotropic BRDF does not depend on ``phi_half``. All angles are in radians. Every angle is computed by ``atan2`` from
the sum and the difference of the directions, because ``arccos`` loses half of the digits at normal incidence, at
``omega_in = omega_out`` and at the horizon (Rusinkiewicz 1998; Nishino 2009, section 2).

The grid has 90 x 90 x 180 nodes over (theta_half, theta_diff, phi_diff). ``theta_half`` is spaced quadratically, so
that most nodes are in the highlight. ``phi_diff`` covers 180 degrees only, because by reciprocity a BRDF is equal at
``phi_diff`` and ``phi_diff`` + 180 degrees. The MERL database divides the angles into bins, and the node of a bin is
the lower edge of the bin.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array, Mask
from dsbrdf.errors import InvalidArgumentError

_UNIT_TOLERANCE = 1e-6
# A cosine closer than this to a bound counts as equal, because rounding must not put a node on the horizon above it.
_COSINE_ROUNDING = 1e-12
# A shorter sum of two unit vectors is rounding error: the directions are opposite.
_SUM_ROUNDING = 4 * float(np.finfo(np.float64).eps)


def half_difference(omega_in: ArrayLike, omega_out: ArrayLike) -> tuple[Array, Array, Array]:
    """Return theta_half, theta_diff and phi_diff (...) [rad] of unit vectors (..., 3) that broadcast.

    ``phi_diff`` is in [0, 2 pi). Opposite directions, possible only at the horizon, have no half vector; the normal
    replaces it. If the half vector is the normal, ``phi_diff`` is the azimuth of ``omega_in``.
    """
    first, second = _vectors("omega_in", omega_in), _vectors("omega_out", omega_out)
    total = first + second
    difference = first - second
    length = np.sqrt(np.einsum("...i,...i->...", total, total))
    total = np.where((length > _SUM_ROUNDING)[..., np.newaxis], total, (0.0, 0.0, 1.0))
    radius = np.hypot(total[..., 0], total[..., 1])
    theta_half = np.arctan2(radius, total[..., 2])
    theta_diff = np.arctan2(np.sqrt(np.einsum("...i,...i->...", difference, difference)), length)

    with np.errstate(invalid="ignore", divide="ignore"):
        cos_phi = np.where(radius > 0.0, total[..., 0] / radius, 1.0)
        sin_phi = np.where(radius > 0.0, total[..., 1] / radius, 0.0)
    along = cos_phi * difference[..., 0] + sin_phi * difference[..., 1]
    across = cos_phi * difference[..., 1] - sin_phi * difference[..., 0]
    # Adding 0.0 turns -0.0 into 0.0, because atan2(0, -0.0) would be pi instead of 0.
    tangent = np.cos(theta_half) * along - np.sin(theta_half) * difference[..., 2] + 0.0
    phi_diff = np.arctan2(across + 0.0, tangent)
    phi_diff = np.where(phi_diff < 0.0, phi_diff + 2.0 * np.pi, phi_diff)
    # A tiny negative angle plus 2 pi is rounded to 2 pi, which is outside of the range [0, 2 pi).
    phi_diff = np.where(phi_diff >= 2.0 * np.pi, 0.0, phi_diff)
    return theta_half, theta_diff, phi_diff


def directions(
    theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike, phi_half: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Return the unit vectors omega_in and omega_out (..., 3) with given angles [rad]; inverse of `half_difference`.

    Either direction may lie below the horizon, which `above_horizon` tests.
    """
    half, diff, phi, azimuth = checked_angles(
        theta_half=theta_half, theta_diff=theta_diff, phi_diff=phi_diff, phi_half=phi_half
    )
    sin_half, cos_half, cos_diff = np.sin(half), np.cos(half), np.cos(diff)
    x, y = np.sin(diff) * np.cos(phi), np.sin(diff) * np.sin(phi)
    cos_azimuth, sin_azimuth = np.cos(azimuth), np.sin(azimuth)

    def rotated(sign: float) -> Array:
        tilted = cos_half * sign * x + sin_half * cos_diff
        parts = np.broadcast_arrays(
            cos_azimuth * tilted - sin_azimuth * sign * y,
            sin_azimuth * tilted + cos_azimuth * sign * y,
            cos_half * cos_diff - sin_half * sign * x,
        )
        return np.stack(parts, axis=-1)

    return rotated(1.0), rotated(-1.0)


def spherical(theta: ArrayLike, phi: ArrayLike) -> Array:
    """Return unit vectors (..., 3) from polar angles and azimuths [rad] whose shapes broadcast."""
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def random_directions(generator: np.random.Generator, cosine: Array) -> Array:
    """Draw unit vectors (..., 3) with random azimuths, whose cosines to the normal are `cosine`."""
    turn, sine = generator.uniform(0.0, 2.0 * np.pi, cosine.shape), np.sqrt(1.0 - cosine**2)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1)


def incident_cosines(theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike) -> tuple[Array, Array]:
    """Return the cosines of omega_in and omega_out to the surface normal from half and difference angles [rad].

    The shapes of the angles broadcast. The two cosines are
    ``cos(theta_half) cos(theta_diff) -/+ sin(theta_half) sin(theta_diff) cos(phi_diff)``.
    """
    half, diff, phi = checked_angles(theta_half=theta_half, theta_diff=theta_diff, phi_diff=phi_diff)
    mean = np.cos(half) * np.cos(diff)
    offset = np.sin(half) * np.sin(diff) * np.cos(phi)
    return mean - offset, mean + offset


def above_horizon(theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike, cutoff: float = np.pi / 2) -> Mask:
    """Return whether both directions are above the horizon, and at most `cutoff` [rad] from the normal.

    A direction exactly at the cutoff is inside, and a direction exactly at the horizon is not above the horizon.
    Raises InvalidArgumentError if the cutoff is out of range.
    """
    check_horizon_cutoff(cutoff)
    cosine = np.minimum(*incident_cosines(theta_half, theta_diff, phi_diff))
    inside = (cosine > _COSINE_ROUNDING) & (cosine >= np.cos(cutoff) - _COSINE_ROUNDING)
    return np.asarray(inside, dtype=np.bool_)


def check_horizon_cutoff(cutoff: float | None) -> None:
    """Raise `InvalidArgumentError` unless the cutoff is None or an angle in (0, pi/2] [rad]."""
    if cutoff is not None and not 0.0 < cutoff <= np.pi / 2:
        raise InvalidArgumentError(
            f"the horizon cutoff must lie above 0 and at most at 90 degrees, not at {np.degrees(cutoff):g}"
        )


def check_directions(name: str, omega: ArrayLike, *, below_horizon: bool = False) -> Array:
    """Check directions (..., 3) and scale them to exact unit length; error messages contain `name`.

    Raises InvalidArgumentError if the shape is wrong, a number is not finite, a length differs from 1 by more than
    1e-6, or a direction is below the horizon (z < 0) without `below_horizon`.
    """
    vectors = _vectors(name, omega)
    if not np.isfinite(vectors).all():
        raise InvalidArgumentError(f"{name} contains NaN or infinity; a direction has three finite numbers.")
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    if (np.abs(length - 1.0) > _UNIT_TOLERANCE).any():
        worst = length.flat[int(np.argmax(np.abs(length - 1.0)))]
        raise InvalidArgumentError(f"{name} must be of unit length (to {_UNIT_TOLERANCE:g}), not {worst:.9g}.")
    lowest = vectors[..., 2].min(initial=1.0)
    if lowest < -_COSINE_ROUNDING and not below_horizon:
        raise InvalidArgumentError(f"{name} must lie on or above the horizon (z >= 0); its smallest z is {lowest:.6g}.")
    unit = np.asarray(vectors / length[..., np.newaxis], dtype=np.float64)
    height = unit[..., 2]
    unit[..., 2] = np.where(height < -_COSINE_ROUNDING, height, np.maximum(height, 0.0))
    return unit


def _vectors(name: str, omega: ArrayLike) -> Array:
    vectors = _numbers(name, omega)
    if vectors.ndim == 0 or vectors.shape[-1] != 3:
        raise InvalidArgumentError(f"{name} must have the shape (..., 3), not {vectors.shape}.")
    return vectors


def checked_angles(**named: ArrayLike) -> tuple[Array, ...]:
    """Return angles as arrays; raise InvalidArgumentError if they are not numeric or do not broadcast."""
    arrays = tuple(_numbers(name, value) for name, value in named.items())
    # Equal shapes need no check, and the check would double the time to evaluate a model at one point.
    if len({array.shape for array in arrays}) == 1:
        return arrays
    try:
        np.broadcast_shapes(*(array.shape for array in arrays))
    except ValueError:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in zip(named, arrays, strict=True))
        raise InvalidArgumentError(f"The angles must broadcast against each other; got {shapes}.") from None
    return arrays


def _numbers(name: str, value: ArrayLike) -> Array:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidArgumentError(f"{name} must be an array of real numbers.") from None


CHANNELS = ("red", "green", "blue")
GRID_SHAPE = (90, 90, 180)
DEFAULT_HORIZON_CUTOFF = float(np.radians(80.0))
"""By default, samples with a direction further than this from the surface normal are left out [rad]."""
CENTER_CUTOFF = float(np.radians(1.0))
"""The paper's procedure and the metrics leave out samples with a smaller theta_half [rad] (Nishino 2009, section 6)."""


def _read_only(array: Array) -> Array:
    array.flags.writeable = False
    return array


THETA_HALF = _read_only(np.deg2rad(np.arange(90) ** 2 / 90.0))
THETA_DIFF = _read_only(np.deg2rad(np.arange(90.0)))
PHI_DIFF = _read_only(np.deg2rad(np.arange(180.0)))
QUARTER = PHI_DIFF.size // 2 + 1
"""Number of nodes of phi_diff from 0 to 90 degrees; models have equal values at phi_diff and pi - phi_diff."""


@lru_cache(maxsize=4)
def nodes_above_horizon(cutoff: float = np.pi / 2) -> Mask:
    """Return a mask (90, 90, 180) of the nodes with both directions above the horizon and within the cutoff.

    The mask is cached, and therefore read-only. A direction is within the cutoff if its angle to the normal [rad] is at
    most `cutoff`.
    """
    above = np.empty(GRID_SHAPE, dtype=np.bool_)
    # The mask is computed for one theta_half at a time, because arrays for the whole grid would need 50 MB.
    for row, theta_half in enumerate(THETA_HALF):
        above[row, :, :QUARTER] = above_horizon(theta_half, THETA_DIFF[:, np.newaxis], PHI_DIFF[:QUARTER], cutoff)
    above[:, :, QUARTER:] = above[:, :, QUARTER - 2 : 0 : -1]
    above.flags.writeable = False
    return above
