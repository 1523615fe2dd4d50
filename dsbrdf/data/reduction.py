"""Reduce a measurement to profiles, sums over phi_diff or over bins of phi_diff, and weight the bins for a fit.

Let f be the samples, w their weights, and m the value of a model that does not depend on phi_diff. For every (channel,
theta_diff, theta_half), the squared error of the model is

    sum_phi w (f - m)**2 = W (mean - m)**2 + within,

where W is the sum of w over phi_diff, ``mean`` the weighted mean of f over phi_diff, and ``within`` the weighted
squared deviation of f from this mean, which does not depend on the model. A fit to `Profiles` is therefore exactly a
fit to all 4.4 million samples. The sum of ``within`` is the **bivariate floor**: no model without phi_diff has a
smaller error.

The values of a reciprocal isotropic material, and of a model with elongated lobes, are equal at phi_diff, -phi_diff and
pi - phi_diff. Therefore phi_diff is folded: mapped to the equivalent angle from 0 to 90 degrees. The samples are summed
in `N_BINS` bins of the folded phi_diff. A fit evaluates the model once for a bin, at the mean of cos(phi_diff)**2 over
the samples of the bin.

The fit of all theta_diff together weights the bins in one of these ways:

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

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.geometry import (
    CENTER_CUTOFF,
    DEFAULT_HORIZON_CUTOFF,
    PHI_DIFF,
    QUARTER,
    THETA_DIFF,
    THETA_HALF,
    incident_cosines,
    nodes_above_horizon,
)
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError

N_BINS = 10
"""Number of bins of the folded phi_diff: nine of 10 degrees each, and one for phi_diff = 90 degrees alone.

A lobe that is stretched far across the plane of incidence can be a narrow peak at phi_diff = 90 degrees, which a bin of
10 degrees would average away.
"""
WEIGHTINGS = ("plain", "cosine", "log")
"""Names of the weightings of samples, which `profiles` describes."""


_BIN_OF = np.minimum(np.arange(180), 180 - np.arange(180)) // 10
IN_BIN = (_BIN_OF[:, None] == np.arange(N_BINS)).astype(float)
"""1 if a phi_diff of the grid belongs to a bin, otherwise 0, shape (180, 10)."""
_COUNT_AND_COS2 = np.hstack([IN_BIN, IN_BIN * np.cos(PHI_DIFF[:, None]) ** 2])
SAMPLES_IN_BIN = IN_BIN[:QUARTER] * np.where(np.arange(QUARTER) % (QUARTER - 1) == 0, 1.0, 2.0)[:, None]
"""Number of nodes of the grid that fold onto each phi_diff up to 90 degrees, in the column of its bin, (91, 10)."""
FIRST_PHI = np.radians(10.0 * np.arange(N_BINS))
"""Smallest folded phi_diff of each bin [rad], at which one of the directions is lowest."""
_MEMBERS = tuple(np.flatnonzero(_BIN_OF == index) for index in range(N_BINS))
_BESIDE = tuple(np.flatnonzero(np.abs(_BIN_OF - index) == 1) for index in range(N_BINS))
OUTLIER_FACTOR = 6.0
"""Weights of samples further than this from the median fall, to 0 at twice this distance [standard deviations]."""
NORMAL_QUARTILE = 1.1503
"""Third quartile of the absolute deviation of a normal variable [standard deviations]."""
# In a bin with fewer samples, half may be outliers, so that the median also takes the samples of the neighbouring bins.
_MIN_SAMPLES_FOR_MEDIAN = 5


@dataclass(frozen=True, eq=False)
class FoldedProfiles:
    """Samples up to the horizon, summed over bins of the folded phi_diff.

    For each (channel, theta_diff, theta_half, bin), `mean` is the mean value [1/sr] and `weight` the number of samples.
    In a robust reduction, a sample counts as less than one if it is far from the other samples of its bin.
    """

    mean: Array  # mean value [1/sr], axes (channel, theta_diff, theta_half, bin of phi_diff)
    weight: Array  # number of samples, axes (channel, theta_diff, theta_half, bin of phi_diff)
    cos2_phi: Array  # mean of cos(phi_diff)**2 over the samples of a bin, axes (theta_diff, theta_half, bin)


@dataclass(frozen=True, eq=False, repr=False)
class Profiles:
    """The sums over phi_diff that a fit needs of a measurement.

    Attributes
    ----------
    mean, weight, within : ndarray, shape (3, 90, 90)
        Weighted mean [1/sr], summed weight, and summed weighted squared deviation from the mean [1/sr^2] over
        phi_diff, for each (channel, theta_diff, theta_half). Where ``weight`` is 0, ``mean`` and ``within`` are 0.
    folded : FoldedProfiles
        Sums over bins of phi_diff, also of samples beyond the horizon cutoff; they are not weighted.
    horizon_cutoff, weighting, robust
        The options of `profiles`.
    name, sha256 : str
        Name and digest of the measurement.
    """

    mean: Array
    weight: Array
    within: Array
    folded: FoldedProfiles
    horizon_cutoff: float | None
    weighting: str
    robust: bool
    name: str
    sha256: str

    def __repr__(self) -> str:
        nodes = f"{np.count_nonzero(self.weight.any(axis=0))} nodes with data"
        return f"<Profiles: {self.name!r}, {nodes}, weighting {self.weighting!r}>"


def profiles(
    measurement: Measurement,
    *,
    horizon_cutoff: float | None = DEFAULT_HORIZON_CUTOFF,
    weighting: str = "plain",
    robust: bool = False,
) -> Profiles:
    """Reduce the samples f of a measurement to profiles over (theta_diff, theta_half).

    Parameters
    ----------
    measurement : Measurement
    horizon_cutoff : float or None, optional
        Samples with a direction further from the normal [rad] are left out; None keeps all samples above the horizon.
    weighting : {"plain", "cosine", "log"}, optional
        ``plain`` gives all samples equal weights, as in the paper. ``cosine`` has the weights cos(theta_in)**2, so that
        the error is that of reflected radiance. ``log`` has the weights (cos_in / (1 + mean cos_in))**2, so that the
        error is to first order that of log(1 + f cos_in).
    robust : bool, optional
        Reduce the weights of samples far from the median over phi_diff.

    Raises
    ------
    InvalidArgumentError
        If an option is unknown or out of range.
    """
    if weighting not in WEIGHTINGS:
        raise InvalidArgumentError(f"weighting must be one of {', '.join(WEIGHTINGS)}, not {weighting!r}")
    shape = (3, THETA_DIFF.size, THETA_HALF.size)
    mean, weight, within = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    folded = FoldedProfiles(np.zeros((*shape, N_BINS)), np.zeros((*shape, N_BINS)), np.zeros((*shape[1:], N_BINS)))
    used_anywhere = used_samples(measurement, horizon_cutoff)
    for i, theta_half in enumerate(THETA_HALF):
        used, samples = used_anywhere[i], measurement.values_at(i)
        _fold(folded, i, samples, measurement.valid[i], robust=robust)
        weights = used.astype(float)
        if robust:
            weights = weights * _outlier_weights(samples, used)
        if weighting != "plain":
            cos_in, _ = incident_cosines(theta_half, THETA_DIFF[:, None], PHI_DIFF)
            typical = _summarize(samples, weights)[0][..., None] if weighting == "log" else 0.0
            weights = weights * (cos_in / (1.0 + typical * np.maximum(cos_in, 0.0))) ** 2
        mean[:, :, i], weight[:, :, i], within[:, :, i] = _summarize(samples, weights)
    name, sha256 = measurement.name, measurement.sha256
    return Profiles(mean, weight, within, folded, horizon_cutoff, weighting, robust, name, sha256)


def used_samples(measurement: Measurement, horizon_cutoff: float | None) -> Mask:
    """Return the mask (90, 90, 180) of the samples whose directions are within the cutoff of the normal [rad]."""
    return measurement.valid & nodes_above_horizon(np.pi / 2 if horizon_cutoff is None else horizon_cutoff)


def _fold(folded: FoldedProfiles, i: int, samples: Array, valid: Mask, *, robust: bool) -> None:
    """Write the means of the samples (3, 90, 180) at the theta_half with index ``i`` into the folded profiles."""
    weights = _trusted_in_bins(samples, valid) if robust else valid.astype(float)
    total = weights @ IN_BIN
    folded.weight[:, :, i] = total
    folded.mean[:, :, i] = (weights * samples) @ IN_BIN / np.where(total > 0.0, total, 1.0)
    count, cos2_phi = np.split(valid.astype(float) @ _COUNT_AND_COS2, 2, axis=1)
    folded.cos2_phi[:, i] = cos2_phi / np.where(count > 0.0, count, 1.0)


def _trusted_in_bins(samples: Array, valid: Mask) -> Array:
    """Return weights of samples (3, 90, 180), low for a sample far from the other samples of its bin.

    The samples of a bin that has too few to find outliers are also compared with those of the neighbouring bins.
    """
    weights = np.zeros(samples.shape)
    for members, beside in zip(_MEMBERS, _BESIDE, strict=True):
        weights[..., members] = _outlier_weights(samples[..., members], valid[:, members])
        count = valid[:, members].sum(axis=1)
        few = np.flatnonzero((count > 0) & (count < _MIN_SAMPLES_FOR_MEDIAN))
        if few.size:
            around = np.concatenate([members, beside])
            judged = _outlier_weights(samples[:, few[:, None], around], valid[few[:, None], around])
            weights[:, few[:, None], members] = judged[..., : members.size]
    return weights * valid


def _summarize(samples: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Return the weighted mean, the summed weight and the weighted squared deviation from the mean (last axis)."""
    total = weights.sum(-1)
    mean = np.einsum("...p,...p->...", weights, samples) / np.where(total > 0, total, 1.0)
    deviation = samples - mean[..., None]
    return mean, total, np.einsum("...p,...p->...", weights * deviation, deviation)


def _outlier_weights(samples: Array, used: Mask) -> Array:
    """Return weights of samples: 1 near the median over phi_diff, falling to 0 for outliers far from the median.

    The samples of a bin often form two groups of unequal values, at phi_diff and at 180 degrees - phi_diff. If samples
    were compared with the median deviation, the smaller of both groups would be outliers; so they are compared with the
    third quartile of the deviations.
    """
    used = np.broadcast_to(used, samples.shape)
    count = used.sum(axis=-1, keepdims=True)
    masked = np.where(used, samples, np.nan)
    # Unused samples are NaN, so that they are sorted behind all used samples.
    ordered = np.sort(masked, axis=-1)
    lower = np.take_along_axis(ordered, np.maximum(count - 1, 0) // 2, axis=-1)
    median = np.where(count > 0, 0.5 * (lower + np.take_along_axis(ordered, count // 2, axis=-1)), 0.0)
    deviations = np.sort(np.abs(masked - median), axis=-1)
    scale = np.take_along_axis(deviations, 3 * np.maximum(count - 1, 0) // 4, axis=-1) / NORMAL_QUARTILE
    # The scale is at least 1 % of the median, because it would be 0 if all samples were equal.
    scale = np.maximum(np.where(count > 0, scale, 0.0), 1e-2 * np.abs(median) + 1e-12)
    relative = np.where(used, np.abs(samples - median) / (OUTLIER_FACTOR * scale), 0.0)
    return np.clip(2.0 - relative, 0.0, 1.0)


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
# If a mirror reflects all light below 1 degree, its nodes keep this weight, because no other nodes have any signal.
_MIN_CENTER_WEIGHT = 1e-9
# Nodes near theta_half = 0 have a solid angle near 0, but the peak value: their relative weight is at least this.
_MIN_RELATIVE_SOLID_ANGLE = 1e-3


def bin_weights(folded: FoldedProfiles, weighting: str, horizon_cutoff: float | None) -> Array:
    """Return the weights of bins, shape (3, 90 theta_diff, 90 theta_half, 10).

    Samples with a direction further from the normal than `horizon_cutoff` [rad] have smaller weights. If the cutoff is
    None, no weight is smaller for this reason.
    """
    level, swing = cosine_parts()
    lowest = np.maximum(level - swing * np.sqrt(folded.cos2_phi), 0.0)
    plain = folded.weight * trust(lowest, horizon_cutoff) * center_share(THETA_HALF)[:, None]
    center = THETA_HALF < CENTER_CUTOFF
    signal = np.sum(plain * folded.mean**2, axis=(0, 1, 3))
    outside = float(signal[~center].sum() / max(signal[center].sum(), TINY))
    plain[:, :, center] *= np.clip(outside, _MIN_CENTER_WEIGHT, 1.0)
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


def cosine_parts() -> tuple[Array, Array]:
    """Return level and swing, both (90, 90, 1): the cosines of the two directions are level -+ swing cos(phi_diff)."""
    level = np.cos(THETA_DIFF)[:, None, None] * np.cos(THETA_HALF)[:, None]
    return level, np.sin(THETA_DIFF)[:, None, None] * np.sin(THETA_HALF)[:, None]


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
