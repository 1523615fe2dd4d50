"""Check samples for a saturated detector, wrong units, a cosine in the values, a turned plane, and single peaks.

This module changes no value. A wrong factor is detected by energy alone: if a lower bound of the albedo is above 1, the
samples reflect more light than they receive. The bound takes the minimum of neighbouring samples over theta_half, so
that a highlight of a single sample does not count.

A cosine and a turned plane are detected by symmetry. A BRDF stays equal if light and viewer are exchanged, but a BRDF
times one cosine does not. The probability of samples is computed by a Gaussian process for the logarithms of the
values: a smooth function of the half and difference angles, with the kernel of `dsbrdf.samples.prediction`, plus the
terms of a diffuse layer. A cosine is reported if the values divided by the cosine are far more probable than the values
as they are, and a turned plane if the samples in the turned plane are far more probable.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.linalg import solve_triangular

from dsbrdf.arrays import Array
from dsbrdf.components.points import Points
from dsbrdf.data.faults import MIN_CLIPPED_FRACTION
from dsbrdf.data.geometry import CHANNELS, half_difference, spherical
from dsbrdf.data.value_faults import channel_findings
from dsbrdf.findings import Finding
from dsbrdf.samples.prediction import smooth_covariance, thinned
from dsbrdf.samples.sample_layers import dark_level
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.samples.values import FAR_OFF_FACTOR

_MAX_ALBEDO_BOUND = 1.05  # limit of plausible albedos, above 1 because of the noise of samples of a white material
# Factors by which values are usually wrong, the most frequent first, each with the phrase that names it in a sentence.
_FACTORS = {
    1.0 / np.pi: "1/pi (scale 0.3183; are they reflectance factors?)",
    1.0 / (100.0 * np.pi): "1/(100 pi) (scale 0.003183; are they reflectance factors in per cent?)",
    1.0 / 100.0: "1/100 (scale 0.01; are they per cent?)",
}
_FACTOR_OF_INTEGERS = {1.0 / 1500.0: "1/1500 (scale 0.0006667; are they the integers of a MERL file?)"}
_MAX_BYTE = 255
_USUAL_ALBEDO = 0.3
# A factor is not suggested if values times the factor have a smaller albedo, because few materials are so dark.
_MIN_ALBEDO = 0.03
# Samples with a smaller albedo are scaled to the usual albedo before the fit.
_MIN_LEVEL = 1e-5
_INCIDENCE_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
_NEAR_INCIDENCE = np.radians(7.6)
_MIN_IN_GROUP = 6  # An angle of incidence with fewer samples is ignored.
# The lower bound of the albedo takes the minimum of this number of samples that are neighbours in theta_half.
_N_NEIGHBOURS = 4
# Symmetry is examined at no more than this number of samples, because the time grows with the cube of the number.
_MAX_ASKED_SAMPLES = 150
# Symmetry is examined without samples whose weight is below this fraction of the mean weight.
_MIN_WEIGHT = 0.1
# The length scales of the Gaussian process are this multiple of the usual length scales in `dsbrdf.samples.prediction`.
_KERNEL_SCALE = 2.0
# Prior variance of the mean logarithm of all values, as a multiple of the variance of the Gaussian process.
_LEVEL_VARIANCE = 10.0
# Variances of each sample's noise and of the instrument's drift, as fractions of the Gaussian process's variance.
# The drift is common to samples at nearly equal theta_in.
_NOISE_VARIANCE = 0.01
# This is added to the most likely variance of the Gaussian process, so that nearly constant values give no extremes.
_MIN_VARIANCE = 0.03
_SAME_INCIDENCE = np.radians(2.0)
# Prior standard deviations of a diffuse layer's exponents, as fractions of the Gaussian process's deviation.
_GROUND_DEVIATIONS = np.array([0.5, 0.4, 0.4, 0.3, 0.25, 0.4])
# A cosine is reported if dividing by it raises twice the log likelihood by more; correct values give up to 10.
_MIN_COSINE_LEAD = 25.0
# A turned plane is reported if turning it raises twice the log likelihood by more; for correct tables it is up to 35.
_MIN_TURNED_LEAD = 50.0
_BRIGHT_QUANTILE = 0.95  # Values above this quantile are the brightest.
# A sample near the mirror direction is reported as a spike if it exceeds its neighbours by more than this factor.
_SPIKE_FACTOR = 8.0
_SPIKE_THETA_HALF = np.radians(3.0)
# A highlight is clipped only if its largest value occurs at this number of different half and difference angles.
_MIN_CLIPPED_PLACES = 4
_PLACE_DEG = 0.5  # Angles are rounded to this step before they are compared.
# A table with fewer different values is too coarse to tell a clipped highlight from a rounded one.
_MIN_LEVELS = 20


@dataclass(frozen=True)
class SampleDoubts:
    """Properties of samples that a user should check.

    Attributes
    ----------
    factor : float
        Factor that gives the samples a usual albedo; 1 if their albedo is usual already.
    findings : tuple of Finding
        A finding on each property to check.
    """

    factor: float
    findings: tuple[Finding, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """The sentences of the findings."""
        return tuple(finding.sentence for finding in self.findings)


def sample_doubts(samples: ScatteredSamples) -> SampleDoubts:
    """Return the properties of samples that a user should check, such as a wrong unit."""
    bound = albedo_bound(samples)
    # For few samples, the bound is far below the albedo, and the median is a better estimate.
    level = max(bound, np.pi * float(np.median(samples.values)) + 1e-4 * float(samples.values.max()))
    factors = _likely_factors(samples.values, level) if bound > _MAX_ALBEDO_BOUND else []
    sentences = _about_energy(samples, bound, factors) if factors else _about_symmetry(samples)
    factor = factors[0][0] if factors else 1.0 if level > _MIN_LEVEL else _USUAL_ALBEDO / level
    doubtful = (Finding("doubtful-table", sentence) for sentence in (*sentences, *_about_spikes(samples)))
    return SampleDoubts(factor, (*_clipping(samples), *channel_findings(samples.values.T), *doubtful))


def _clipping(samples: ScatteredSamples) -> Iterator[Finding]:
    """Yield a finding if the largest value of a channel fills most of a highlight, as from a saturated detector."""
    theta_half, theta_diff, _ = half_difference(samples.omega_in, samples.omega_out)
    # Samples that are equal by symmetry have one place.
    places = np.rint(np.degrees([theta_half, theta_diff]) / _PLACE_DEG)
    thetas = np.sort(np.arccos(np.clip([samples.omega_in[:, 2], samples.omega_out[:, 2]], 0.0, 1.0)), axis=0)
    names, clipped = list[str](), np.zeros(samples.values.shape, dtype=bool)
    for channel, values in enumerate(samples.values.T):
        top, near = (values >= fraction * values.max() for fraction in (1.0 - 1e-9, 0.9))
        n_top, n_near = (np.unique(places[:, chosen], axis=1).shape[1] for chosen in (top, near))
        # Equal peaks at one theta_half or back to the light, and equal values at one pair of thetas are not clipped.
        spread = np.degrees(np.ptp(thetas[:, top], axis=1).max())
        is_wide = min(np.ptp(places[0, top]), places[1, top].max(), spread) > 1.0
        levels = np.unique(values)
        # A largest value far above all others is a code, which `about_repeated` reports.
        is_reached = levels.size >= _MIN_LEVELS and levels[-1] < FAR_OFF_FACTOR * levels[-2]
        is_highlight = is_wide and is_reached and near.mean() < 0.5
        if is_highlight and n_top >= max(_MIN_CLIPPED_PLACES, MIN_CLIPPED_FRACTION * n_near):
            names.append(CHANNELS[channel])
            clipped[:, channel] = top
    if names:
        count, value = int(np.count_nonzero(clipped.any(axis=1))), float(samples.values[clipped].max())
        yield Finding(
            "clipped-highlight",
            f"The highlight is clipped: {count} samples equal the largest value in {' and '.join(names)}, "
            f"{value:.3g}/sr, as from a saturated detector. The fit follows them, so that its highlight is too dim. "
            "Measure them again with a shorter exposure, or leave them out: set missing to their value in the table.",
            {"fraction": count / len(clipped), "value": value},
        )


def _about_energy(samples: ScatteredSamples, bound: float, factors: list[tuple[float, str]]) -> Iterator[str]:
    side = _side_of_cosine(_leads(samples))
    named = " or ".join(words for _, words in factors)
    cosine = "" if side is None else f', and set cosine to "{side}": they look like a BRDF times that cosine'
    yield (
        f"The samples reflect more light than they receive, at least {bound:.3g} times as much: they are not a "
        f"BRDF in 1/sr; multiply the values by {named}{cosine}."
    )


def _about_symmetry(samples: ScatteredSamples) -> Iterator[str]:
    leads, level = _leads(samples), samples.values.mean(axis=1)
    brightest = samples.take(level >= np.quantile(level, _BRIGHT_QUANTILE))
    # A detector in front of the lamp darkens samples towards the light, which a turned plane would explain as well.
    is_towards_light = np.sum(brightest.omega_in[:, :2] * brightest.omega_out[:, :2]) > 0.0
    if leads["turned"] > _MIN_TURNED_LEAD and is_towards_light:
        yield (
            "The brightest samples lie back towards the light, as those of a retro-reflector do: if the material is "
            'none, light and viewer have the same phi in the mirror direction: set phi to "mirror".'
        )
    elif (side := _side_of_cosine(leads)) is not None:
        yield (
            f"The values look like a BRDF times the cosine of theta_{side}: divided by this cosine, but not as they "
            f'are, they stay equal if light and viewer are exchanged, as a BRDF does. If so, set cosine to "{side}".'
        )


def _side_of_cosine(leads: dict[str, float]) -> str | None:
    """Return "in" or "out" if the values were probably multiplied by this direction's cosine, else None."""
    side = max(("in", "out"), key=leads.__getitem__)
    return side if leads[side] > _MIN_COSINE_LEAD else None


def _leads(samples: ScatteredSamples) -> dict[str, float]:
    """Return by how much twice the log likelihood rises if samples are divided by a cosine, or turned."""
    dark = dark_level(samples)
    counted = (samples.values.mean(axis=1) > dark) & (samples.weight > _MIN_WEIGHT * samples.weight.mean())
    if np.count_nonzero(counted) < _MIN_IN_GROUP:
        return {"in": 0.0, "out": 0.0, "turned": 0.0}
    asked = thinned(samples.take(counted), _MAX_ASKED_SAMPLES)
    turned = replace(asked, omega_in=asked.omega_in * np.array([-1.0, -1.0, 1.0]))
    logs = np.log(asked.values.mean(axis=1) + dark)
    cosines = np.log([asked.omega_in[:, 2], asked.omega_out[:, 2]])
    as_is, over_in, over_out = _likelihood(asked, np.stack([logs, *(logs - cosines)], axis=1)).tolist()
    (around,) = _likelihood(turned, logs[:, np.newaxis]).tolist()
    return {"in": over_in - as_is, "out": over_out - as_is, "turned": around - as_is}


def _likelihood(samples: ScatteredSamples, logs: Array) -> Array:
    """Return twice the log likelihood of each of k versions of the samples, given as logarithms of values (n, k)."""
    angles = half_difference(samples.omega_in, samples.omega_out)
    ground = Points.at(*angles).ground
    shapes = (ground - ground.mean(axis=1, keepdims=True)) * _GROUND_DEVIATIONS[:, np.newaxis]
    smooth = smooth_covariance(*angles, _KERNEL_SCALE) + shapes.T @ shapes
    theta_in = np.arccos(samples.omega_in[:, 2])
    drift = np.exp(-0.5 * (np.subtract.outer(theta_in, theta_in) / _SAME_INCIDENCE) ** 2)
    root = np.linalg.cholesky(smooth + _LEVEL_VARIANCE + _NOISE_VARIANCE * (np.eye(len(logs)) + drift))
    whitened = solve_triangular(root, logs - logs.mean(axis=0), lower=True)
    variance = np.mean(whitened**2, axis=0) + _MIN_VARIANCE
    return np.asarray(-len(logs) * np.log(variance) - 2.0 * np.sum(np.log(np.diag(root))))


def _likely_factors(values: Array, level: float) -> list[tuple[float, str]]:
    """Return the usual factors that turn an albedo of about `level` into an albedo below 1, most frequent first."""
    known = (_FACTOR_OF_INTEGERS if np.all(values == np.rint(values)) else {}) | _FACTORS
    if values.max() == _MAX_BYTE and np.all(values == np.rint(values)):
        return [(_USUAL_ALBEDO / level, "what makes them 1/sr; as in pictures of 8 bits, they may not even be linear")]
    likely = [item for item in known.items() if _MIN_ALBEDO < item[0] * level < _MAX_ALBEDO_BOUND]
    return likely or [(_USUAL_ALBEDO / level, "what makes them 1/sr")]


def albedo_bound(samples: ScatteredSamples) -> float:
    """Return a lower bound of the directional albedo of samples, the largest over angles of incidence and channels.

    At each angle of incidence, the bound integrates a function of theta_half: the minimum of the samples next to this
    theta_half, and 0 beyond the last sample.
    """
    theta_half = half_difference(samples.omega_in, samples.omega_out)[0]
    cosines = np.stack([samples.omega_in[:, 2], samples.omega_out[:, 2]])
    angles, largest = np.arccos(np.clip(cosines, 0.0, 1.0)), 0.0
    for incidence in _INCIDENCE_DEG:
        near = np.any(np.abs(angles - np.radians(incidence)) < _NEAR_INCIDENCE, axis=0)
        if np.count_nonzero(near) < _MIN_IN_GROUP:
            continue
        order = np.argsort(theta_half[near])
        half, values = theta_half[near][order], samples.values[near][order]
        # Between two samples in theta_half, the minimum is over one sample below and three samples above.
        beside = np.arange(half.size)[:, np.newaxis] + np.arange(-1, _N_NEIGHBOURS - 1)
        least = values[np.clip(beside, 0, half.size - 1)].min(axis=1)
        nodes, light = _outgoing(incidence)
        between = np.diff(light[np.searchsorted(nodes, half, side="right")], prepend=0.0)
        largest = max(largest, float((between @ least).max()))
    return largest


@cache
def _outgoing(incidence_deg: float) -> tuple[Array, Array]:
    """Return ascending theta_half of outgoing directions, and the projected solid angle below each theta_half."""
    theta, phi = np.meshgrid(np.radians(np.arange(0.5, 90.0)), np.radians(np.arange(1.5, 180.0, 3.0)), indexing="ij")
    omega_out = spherical(theta.ravel(), phi.ravel())
    omega_in = np.broadcast_to(spherical(np.radians(incidence_deg), np.pi), omega_out.shape)
    theta_half, weight = half_difference(omega_in, omega_out)[0], (np.sin(theta) * np.cos(theta)).ravel()
    order = np.argsort(theta_half)
    return theta_half[order], np.pi * np.cumsum([0.0, *weight[order]]) / weight.sum()


def _about_spikes(samples: ScatteredSamples) -> Iterator[str]:
    """Yield a sentence if highlights contain only a single sample at most angles of incidence."""
    theta_half = half_difference(samples.omega_in, samples.omega_out)[0]
    incidence = np.degrees(np.arccos(np.clip(samples.omega_in[:, 2], 0.0, 1.0))).round(1)
    level = samples.values.mean(axis=1)
    seen, covered, ratios, gaps = 0, 0, list[float](), list[float]()
    for angle in np.unique(incidence):
        group = np.flatnonzero(incidence == angle)
        if group.size < _MIN_IN_GROUP:
            continue
        covered += group.size
        order = group[np.argsort(theta_half[group])]
        # Samples repeated at one pair of directions do not count as neighbours of each other.
        first = np.flatnonzero(theta_half[order] > theta_half[order[0]] + 1e-3)
        if theta_half[order[0]] > _SPIKE_THETA_HALF or first.size < _MIN_IN_GROUP - 1:
            continue
        seen += 1
        beside = level[order[first[:_N_NEIGHBOURS]]].max()
        if level[order[0]] > _SPIKE_FACTOR * beside > 0.0:
            ratios.append(float(level[order[0]] / beside))
            gaps.append(float(np.degrees(theta_half[order[first[0]]])))
    # The sentence is left out for random directions, where few samples have equal angles of incidence.
    if ratios and 2 * len(ratios) >= seen and 2 * covered > len(level):
        yield (
            f"At {len(ratios)} {'angle' if len(ratios) == 1 else 'angles'} of incidence one sample alone lies in the "
            f"highlight: it is up to {max(ratios):.2g} times as bright as its neighbours, at theta_half = "
            f"{np.median(gaps):.2g} degrees and more: the samples determine the height of the highlight, but not its "
            "width: measure between them."
        )
