"""Weights of the bins of samples in the fit of all rows.

``plain``
    Every sample within the horizon cutoff counts alike: the paper's squared error of f. Beyond the cutoff, where
    measurements cannot be trusted, samples count with the eighth power of the cosine to the horizon, and where
    theta_half < 1 degree, where nodes crowd, by their solid angle, and all together no more than the others: the peak
    of a mirror-like coat would leave nothing to them.
``cosine``
    As ``plain``, times cos(theta_in) cos(theta_out): the squared error of reflected radiance.
``log``
    As ``cosine``, divided by (1 + mean)**2: about the squared error of log(1 + f).
``balanced``
    The sum of two errors, each in units of what the best model without phi_diff would have: ``plain``, and 1.75 times
    the error that a lit sphere shows. There a node counts by its solid angle and by
    cos(theta_in) cos(theta_out), and a screen shows about f**0.4 of radiance f, so that errors count relative to
    f**1.2. The first alone leaves the diffuse part to chance, the second alone the height of grazing highlights.
"""

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.grid import CENTER_CUTOFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import FoldedProfiles

SEEN_FACTOR = 1.75
"""Weight of the error that a lit sphere shows, in ``balanced``: 1 costs 0.4 dB of psnr, 3 some 3 % of excess."""
SEEN_POWER = 1.2
"""Errors count relative to f to this power."""
DARK_VALUE_FRACTION = 0.02
"""Fraction of a typical value below which the errors of values count as those of this fraction."""
# Relative to the squared signal; the floor of a material that does not depend on phi_diff is nearly 0.
_MIN_RELATIVE_FLOOR = 1e-4
_TRUST_POWER = 8
TINY = 1e-300
"""Keeps a sum of weights from being 0."""
# The solid angle of a node at theta_half = 0 is nearly 0, but its value is the peak.
_MIN_RELATIVE_SOLID_ANGLE = 1e-3


def bin_weights(folded: FoldedProfiles, weighting: str, horizon_cutoff: float | None) -> Array:
    """Return weights of the bins, shape (3, 90 theta_diff, 90 theta_half, 10).

    Samples beyond the cutoff, an angle to the normal [rad], get smaller weights; with None all are trusted alike.
    """
    # Both cosines to the normal are level -/+ swing cos(phi_diff).
    level = np.cos(THETA_DIFF)[:, None, None] * np.cos(THETA_HALF)[:, None]
    swing = np.sin(THETA_DIFF)[:, None, None] * np.sin(THETA_HALF)[:, None]
    lowest = np.maximum(level - swing * np.sqrt(folded.cos2_phi), 0.0)
    plain = folded.weight * trust(lowest, horizon_cutoff) * center_share(THETA_HALF)[:, None]
    center = THETA_HALF < CENTER_CUTOFF
    signal = np.sum(plain * folded.mean**2, axis=(0, 1, 3))
    plain[:, :, center] *= min(float(signal[~center].sum() / max(signal[center].sum(), TINY)), 1.0)
    if weighting == "plain":
        return plain
    cosines = np.maximum(level**2 - swing**2 * folded.cos2_phi, 0.0)
    mean = _over_phi(folded.mean, folded.weight)[..., None]
    if weighting == "cosine":
        return plain * cosines
    if weighting == "log":
        return plain * cosines / (1.0 + mean) ** 2
    across, cosine = np.maximum(np.sin(2.0 * THETA_DIFF), 0.0) + 0.1, np.cos(interval_ends(THETA_HALF))
    solid_angle = across[:, None, None] * (cosine[:-1] - cosine[1:])[:, None]
    lit = folded.weight * cosines * solid_angle
    seen = seen_weight(lit, mean, float(np.sum(lit * folded.mean)) / (float(np.sum(lit)) or 1.0))
    return plain / _floor(folded, plain) + SEEN_FACTOR * seen / _floor(folded, seen)


def _floor(folded: FoldedProfiles, weight: Array) -> float:
    """Return the weighted squared error of the mean over phi_diff, at least a small fraction of the squared signal."""
    mean = _over_phi(folded.mean, weight)[..., None]
    scatter = float(np.sum(weight * (folded.mean - mean) ** 2))
    signal = float(np.sum(weight * folded.mean**2))
    return scatter + _MIN_RELATIVE_FLOOR * signal or 1.0


def _over_phi(values: Array, weight: Array) -> Array:
    total = weight.sum(axis=3)
    return np.asarray(np.sum(weight * values, axis=3) / np.where(total > 0.0, total, 1.0))


def trust(lowest: Array, horizon_cutoff: float | None) -> Array:
    """Return 1 within the cutoff, falling to 0 at the horizon, for the smaller of the two cosines to the normal."""
    if horizon_cutoff is None or np.cos(horizon_cutoff) < 1e-9:
        return np.ones_like(lowest)
    return np.asarray(np.minimum(lowest / np.cos(horizon_cutoff), 1.0) ** _TRUST_POWER)


def seen_weight(lit: Array, mean: Array, typical: float, power: float = SEEN_POWER) -> Array:
    """Turn weights of errors of radiance into weights of errors as a screen shows them."""
    return np.asarray(lit / (mean + DARK_VALUE_FRACTION * typical + 1e-12) ** power)


def center_share(theta_half: Array) -> Array:
    """Return the solid angle of the nodes below 1 degree in units of a node at 1 degree; 1 beyond."""
    return np.asarray(np.minimum((theta_half / CENTER_CUTOFF) ** 1.5 + _MIN_RELATIVE_SOLID_ANGLE, 1.0))


def interval_ends(nodes: Array, last: float = np.pi / 2) -> Array:
    """Return the ends (n + 1,) of the intervals that ascending angles (n,) represent, from 0 to the last angle."""
    return np.concatenate([[0.0], 0.5 * (nodes[1:] + nodes[:-1]), [last]])
