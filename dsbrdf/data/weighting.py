"""Compute the weights of bins of samples for the fit of a model at all theta_diff together.

``plain``
    All samples within the horizon cutoff have equal weights, as in the paper. Beyond the cutoff, where measurements are
    unreliable, weights fall with the eighth power of the smaller cosine to the normal. At theta_half below 1 degree,
    the nodes of the grid are dense, so that a node has its solid angle as weight. These dense nodes together weigh at
    most as much as all other nodes: otherwise a fit of a mirror-like coat would consider only the peak.
``cosine``
    The weights ``plain`` times cos(theta_in) cos(theta_out): the squared error of reflected radiance.
``log``
    The weights ``cosine`` divided by (1 + mean of f)**2: approximately the squared error of log(1 + f).
``balanced``
    The sum of two errors, each divided by the error of the best model that ignores phi_diff: the ``plain`` error, and
    1.75 times the error in a rendering of a lit sphere. For the sphere, the weight of a node is its solid angle times
    cos(theta_in) cos(theta_out), and errors are relative to f**1.2, because a screen shows radiance f as about f**0.4.
    The ``plain`` error alone does not determine the diffuse part, and the sphere's error alone does not determine the
    peak values of grazing highlights.
"""

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.grid import CENTER_CUTOFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import FoldedProfiles

SEEN_FACTOR = 1.75
"""Weight of the sphere's error in ``balanced``; with 1, psnr is 0.4 dB lower; with 3, excess is some 3 % larger."""
SEEN_POWER = 1.2
"""In a rendering of a lit sphere, errors of the BRDF f are relative to this power of f."""
DARK_VALUE_FRACTION = 0.02
"""This fraction of a typical value is added before weights are divided by values, to bound the weights of dark ones."""
# This fraction of the squared signal is added to the error of the best model, because the sum is a divisor.
_MIN_RELATIVE_FLOOR = 1e-4
TINY = 1e-300
"""Added to sums of weights that are divisors, so that they are not 0."""
# Nodes near theta_half = 0 have a solid angle near 0, but the peak value: their relative weight is at least this.
_MIN_RELATIVE_SOLID_ANGLE = 1e-3


def bin_weights(folded: FoldedProfiles, weighting: str, horizon_cutoff: float | None) -> Array:
    """Return the weights of bins, shape (3, 90 theta_diff, 90 theta_half, 10).

    Samples with a direction further from the normal than `horizon_cutoff` [rad] have smaller weights. If the cutoff is
    None, no weight is smaller for this reason.
    """
    # The cosines of the two directions to the normal are level - swing cos(phi_diff) and level + swing cos(phi_diff).
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
    """Return the summed squared deviation of values from the mean over phi_diff, plus 1e-4 of the summed squares."""
    deviation = folded.mean - _over_phi(folded.mean, weight)[..., None]
    scatter = float(np.vdot(weight * deviation, deviation))
    signal = float(np.vdot(weight * folded.mean, folded.mean))
    return scatter + _MIN_RELATIVE_FLOOR * signal or 1.0


def _over_phi(values: Array, weight: Array) -> Array:
    total = np.einsum("...p->...", weight)
    return np.asarray(np.einsum("...p,...p->...", weight, values) / np.where(total > 0.0, total, 1.0))


def trust(lowest: Array, horizon_cutoff: float | None) -> Array:
    """Return weights for the smaller cosine to the normal of two directions: 1 within the cutoff, 0 at the horizon."""
    if horizon_cutoff is None or np.cos(horizon_cutoff) < 1e-9:
        return np.ones_like(lowest)
    squared = np.square(np.minimum(lowest / np.cos(horizon_cutoff), 1.0))
    return np.asarray(np.square(np.square(squared)))


def seen_weight(lit: Array, mean: Array, typical: float, power: float = SEEN_POWER) -> Array:
    """Divide the weights of errors of radiance by a power of the values, so that errors weigh as on a screen."""
    return np.asarray(lit / (mean + DARK_VALUE_FRACTION * typical + 1e-12) ** power)


def center_share(theta_half: Array) -> Array:
    """Return the solid angle of nodes with theta_half below 1 degree, relative to a node at 1 degree; 1 for others."""
    return np.asarray(np.minimum((theta_half / CENTER_CUTOFF) ** 1.5 + _MIN_RELATIVE_SOLID_ANGLE, 1.0))


def interval_ends(nodes: Array, last: float = np.pi / 2) -> Array:
    """Return the n + 1 ends of the intervals around n increasing angles, from 0 to `last` [rad]."""
    return np.concatenate([[0.0], 0.5 * (nodes[1:] + nodes[:-1]), [last]])
