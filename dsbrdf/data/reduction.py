"""Reduce a measurement to profiles: sums over phi_diff, or over bins of phi_diff.

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
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.geometry import incident_cosines
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, QUARTER, THETA_DIFF, THETA_HALF, nodes_above_horizon
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
SAMPLES_IN_BIN = IN_BIN[:QUARTER] * np.where(np.arange(QUARTER) % (QUARTER - 1) == 0, 1.0, 2.0)[:, None]
"""Number of nodes of the grid that fold onto each phi_diff up to 90 degrees, in the column of its bin, (91, 10)."""
_MEMBERS = tuple(np.flatnonzero(_BIN_OF == index) for index in range(N_BINS))
_BESIDE = tuple(np.flatnonzero(np.abs(_BIN_OF - index) == 1) for index in range(N_BINS))
OUTLIER = 6.0
"""Weights of samples further than this from the median fall, to 0 at twice this distance [standard deviations]."""
NORMAL_QUARTILE = 1.1503
"""Third quartile of the absolute deviation of a normal variable [standard deviations]."""
# In a bin with fewer samples, half may be outliers, so that the median also takes the samples of the neighbouring bins.
_MIN_SAMPLES_FOR_MEDIAN = 5


@dataclass(frozen=True, eq=False)
class FoldedProfiles:
    """Hold samples up to the horizon, summed over bins of the folded phi_diff.

    For each (channel, theta_diff, theta_half, bin), `mean` is the mean value [1/sr] and `weight` the number of samples.
    In a robust reduction, a sample counts as less than one if it is far from the other samples of its bin.
    """

    mean: Array  # mean value [1/sr], axes (channel, theta_diff, theta_half, bin of phi_diff)
    weight: Array  # number of samples, axes (channel, theta_diff, theta_half, bin of phi_diff)
    cos2_phi: Array  # mean of cos(phi_diff)**2 over the samples of a bin, axes (theta_diff, theta_half, bin)


@dataclass(frozen=True, eq=False, repr=False)
class Profiles:
    """Hold the sums over phi_diff that a fit needs of a measurement.

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
    for i, theta_half in enumerate(THETA_HALF):
        used, known = used_samples(measurement, i, horizon_cutoff), measurement.known[:, i]
        samples = measurement.stored[:, i] * measurement.scale[:, None, None]
        _fold(folded, i, samples, known, robust=robust)
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


def used_samples(measurement: Measurement, i: int, horizon_cutoff: float | None) -> Mask:
    """Return the mask (channels, 90 theta_diff, 180 phi_diff) of the used samples at the theta_half with index ``i``.

    The first axis has the length 1 if one mask is common to all channels, otherwise 3.
    """
    cutoff = np.pi / 2 if horizon_cutoff is None else horizon_cutoff
    return measurement.known[:, i] & nodes_above_horizon(cutoff)[i]


def _fold(folded: FoldedProfiles, i: int, samples: Array, known: Mask, *, robust: bool) -> None:
    """Write the means of the samples (3, 90, 180) at the theta_half with index ``i`` into the folded profiles."""
    weights, valid = known.astype(float), known.any(axis=0)
    if robust:
        weights = _trusted_in_bins(samples, np.broadcast_to(known, samples.shape))
    total = weights @ IN_BIN
    folded.weight[:, :, i] = total
    folded.mean[:, :, i] = (weights * samples) @ IN_BIN / np.where(total > 0.0, total, 1.0)
    count = valid.astype(float) @ IN_BIN
    folded.cos2_phi[:, i] = (valid * np.cos(PHI_DIFF) ** 2) @ IN_BIN / np.where(count > 0.0, count, 1.0)


def _trusted_in_bins(samples: Array, known: Mask) -> Array:
    """Return weights of samples (3, 90, 180), low for a sample far from the other samples of its bin.

    The samples of a bin that has too few to find outliers are also compared with those of the neighbouring bins.
    """
    weights = np.zeros(samples.shape)
    for members, beside in zip(_MEMBERS, _BESIDE, strict=True):
        weights[..., members] = _outlier_weights(samples[..., members], known[..., members])
        count = known[..., members].sum(axis=2)
        few = np.flatnonzero(((count > 0) & (count < _MIN_SAMPLES_FOR_MEDIAN)).any(axis=0))
        if few.size:
            around = np.concatenate([members, beside])
            judged = _outlier_weights(samples[:, few[:, None], around], known[:, few[:, None], around])
            weights[:, few[:, None], members] = judged[..., : members.size]
    return weights * known


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
    relative = np.where(used, np.abs(samples - median) / (OUTLIER * scale), 0.0)
    return np.clip(2.0 - relative, 0.0, 1.0)
