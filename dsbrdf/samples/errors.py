"""Estimate the error of a fit of scattered samples: at samples left out of the fit, and expected over all directions.

To fit again without each sample would be too slow. Instead, the value of the fit at a sample left out is the fitted
value times the ratio of two predictions (`dsbrdf.samples.prediction`): one made without the sample, and one with it.

The expected error over all directions has two parts. The first is the median error of the model if the material, away
from the samples, equalled one of several probable stacks of layers. The second is the uncertainty of values closer to
the mirror direction than all samples: the logarithm of a value at theta_half = a is uncertain by log(b / a), where b is
the smallest theta_half of a sample. Both parts are integrals over pairs of directions, in which half of the weight is
proportional to the reflected light, and half is uniform. Both parts are calibrated on materials whose values are known
everywhere.

The pairs of directions to measure next are chosen one after another; each lowers the expected squared error most.
"""

import itertools
from collections.abc import Iterator
from functools import cache

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import directions, half_difference, incident_cosines
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.report import LeftOutErrors, SuggestedPair
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.samples.prediction import SamplePrediction, left_out_predictions
from dsbrdf.samples.sample_layers import dark_level
from dsbrdf.samples.scattered_samples import ScatteredSamples

# Errors are reported separately for samples in bands of theta_out with these edges.
_THETA_OUT_EDGES_DEG = (0, 30, 60, 75, 90)
# Errors are reported separately for samples near the mirror direction, which have a theta_half below this.
_NEAR_MIRROR_DEG = 10
N_SUGGESTED = 20
_N_CANDIDATES = 700
# The variance of the logarithm of a value near the mirror direction counts as at most this.
_MAX_LOG_VARIANCE = 1.0
# With these factors of its two parts, the expected error is below the true error for one of ten in 220 tables.
# The 220 tables have 50 to 1,000 samples, in one plane or in all planes, of 33 materials, of which six are measured.
_LAYER_FACTOR = 1.8
_GAP_FACTOR = 1.4
_LAST_COSINE = float(np.cos(np.radians(80.0)))
# Two suggested pairs differ by at least this angle in theta_in, theta_out or phi.
_MIN_PAIR_DISTANCE_DEG = 4.0
# A sample is unconfirmed only if a fit without the sample misses the logarithm of its value by more than this.
_UNCONFIRMED_LOG = np.log(3.0)
# A sample is unconfirmed only if its squared error is more than this fraction of the sum over all samples.
_UNCONFIRMED_FRACTION = 0.5
# Suggested directions are at least 8 degrees apart, because light and detector of an instrument would cover each other.
_MAX_COSINE_BETWEEN = np.cos(np.radians(8.0))


def relative_rms(values: Array, expected: Array, weight: Array) -> float | None:
    """Return the relative RMS error of values (n, 3); None if all expected values have no weight or are 0."""
    signal = float(np.sum(weight[:, np.newaxis] * expected**2))
    return float(np.sqrt(np.sum(weight[:, np.newaxis] * (values - expected) ** 2) / signal)) if signal > 0.0 else None


def left_out_values(samples: ScatteredSamples, prediction: SamplePrediction, model: DSBRDF) -> Array:
    """Return, for each sample, the value [1/sr] that a fit without this sample would have there, shape (n, 3)."""
    angles = half_difference(samples.omega_in, samples.omega_out)
    dark = prediction.layers.dark
    ratio = (left_out_predictions(samples, prediction) + dark) / (prediction.likely(*angles) + dark)
    return model.evaluate_unmasked(*angles) * ratio


def unconfirmed_sample(samples: ScatteredSamples, values: Array) -> Iterator[str]:
    """Yield a sentence on a single sample that contradicts all others, if it has most of the squared error."""
    dark = dark_level(samples)
    off = np.log((samples.values.mean(axis=1) + dark) / (values.mean(axis=1) + dark))
    at = int(np.argmax(np.abs(off)))
    if np.abs(off[at]) > _UNCONFIRMED_LOG and off[at] ** 2 > _UNCONFIRMED_FRACTION * np.sum(off**2):
        pair = _suggested(samples.omega_in[at], samples.omega_out[at])
        yield (
            f"Much depends on one sample, at theta_in = {pair.theta_in_deg:.0f}, theta_out = {pair.theta_out_deg:.0f} "
            f"and phi = {pair.phi_deg:.0f} degrees: it is {np.exp(off[at]):.2g} times what a fit without it has there; "
            "measure near it again, or leave it out if it is wrong."
        )


def left_out_errors(
    samples: ScatteredSamples, values: Array, cutoff: float | None
) -> tuple[float | None, tuple[LeftOutErrors, ...]]:
    """Return the errors of the `left_out_values`: in total within the cutoff, and separately for groups of samples."""
    theta_half = np.degrees(half_difference(samples.omega_in, samples.omega_out)[0])
    theta_out = np.degrees(np.arccos(samples.omega_out[:, 2]))
    places = [
        (f"theta_out from {low} to {high} degrees", (theta_out >= low) & (theta_out < high))
        for low, high in itertools.pairwise(_THETA_OUT_EDGES_DEG)
    ]
    places.append((f"theta_half below {_NEAR_MIRROR_DEG} degrees", theta_half < _NEAR_MIRROR_DEG))
    rows = tuple(
        LeftOutErrors(where, int(np.count_nonzero(chosen)), error)
        for where, chosen in places
        if (error := relative_rms(values, samples.values, samples.weight * chosen)) is not None
    )
    return relative_rms(values, samples.values, _weight_within(samples, cutoff)), rows


def scattered_metrics(model: DSBRDF, samples: ScatteredSamples, horizon_cutoff: float | None = None) -> Metrics:
    """Return errors of a model at samples: `relative_rms` within the cutoff, and `male` at all samples."""
    fitted, cosine = model.evaluate_directions(samples.omega_in, samples.omega_out), samples.omega_in[:, 2:]
    log_error = np.abs(np.log1p(samples.values * cosine) - np.log1p(fitted * cosine))
    return Metrics(
        relative_rms=relative_rms(fitted, samples.values, _weight_within(samples, horizon_cutoff)),
        male=float(np.average(log_error.mean(axis=1), weights=samples.weight)),
    )


def _weight_within(samples: ScatteredSamples, cutoff: float | None) -> Array:
    """Return the weights of the samples, with 0 if a direction is further from the normal than the cutoff."""
    lowest = np.minimum(samples.omega_in[:, 2], samples.omega_out[:, 2])
    return samples.weight * (lowest >= np.cos(np.pi / 2 if cutoff is None else cutoff + 1e-9))


def expected_error(prediction: SamplePrediction, model: DSBRDF, samples: ScatteredSamples) -> float:
    """Return a `relative_rms` over all directions that the true error exceeds for one table in ten."""
    angles, weight, cosine = _nodes()
    layers = prediction.layers
    values = model.evaluate_unmasked(*angles) + layers.dark
    drawn = layers.drawn_logs(*angles) - np.log(layers.evaluate_unmasked(*angles) + layers.dark)

    def relative(true: Array, squared_error: Array) -> float:
        light = weight * cosine * true.mean(axis=1)
        counted = light / light.sum() + weight / weight.sum()
        return float(np.sqrt(np.sum(counted * squared_error) / np.sum(counted * np.sum(true**2, axis=1))))

    trues = values * np.exp(np.sqrt(prediction.remoteness(*angles, samples))[:, np.newaxis] * drawn)
    of_layers = float(np.median([relative(true, np.sum((values - true) ** 2, axis=1)) for true in trues]))
    nearest = half_difference(samples.omega_in, samples.omega_out)[0].min()
    variance = np.minimum(np.log(np.maximum(nearest / angles[0], 1.0)) ** 2, _MAX_LOG_VARIANCE)
    of_gap = relative(values, np.sum(values**2, axis=1) * np.expm1(variance))
    return float(np.hypot(_LAYER_FACTOR * of_layers, _GAP_FACTOR * of_gap))


@cache
def _nodes() -> tuple[tuple[Array, Array, Array], Array, Array]:
    """Return angles of pairs of directions within 80 degrees of the normal, their weights, and cos(theta_in)."""
    edges = np.concatenate([[0.0], np.geomspace(5e-4, np.pi / 2.0, 32)]), np.linspace(0.0, np.pi / 2.25, 21)
    middle_half, middle_diff = (0.5 * (edge[1:] + edge[:-1]) for edge in edges)
    measure = np.diff(-np.cos(edges[0]))[:, np.newaxis, np.newaxis] * np.diff(np.sin(edges[1]) ** 2)[:, np.newaxis]
    half, diff, phi = np.meshgrid(middle_half, middle_diff, (np.arange(4) + 0.5) * np.pi / 8.0, indexing="ij")
    cos_in, cos_out = incident_cosines(half, diff, phi)
    seen = np.minimum(cos_in, cos_out) >= _LAST_COSINE
    return (half[seen], diff[seen], phi[seen]), (measure * cos_in * cos_out)[seen], cos_in[seen]


def pairs_to_measure(prediction: SamplePrediction, model: DSBRDF) -> tuple[SuggestedPair, ...]:
    """Return pairs of directions to measure next, the most useful first."""
    nodes, weight, cosine = _nodes()
    light = weight * cosine * model.evaluate_unmasked(*nodes).mean(axis=1)
    generator = np.random.default_rng(5)
    drawn = [generator.choice(light.size, _N_CANDIDATES // 2, p=p / p.sum()) for p in (light, weight)]
    pairs = directions(*(angle[np.unique(drawn)] for angle in nodes))
    far = np.sum(pairs[0] * pairs[1], axis=1) < _MAX_COSINE_BETWEEN
    omega_in, omega_out = (side[far] for side in pairs)
    angles = half_difference(omega_in, omega_out)
    squared = np.sum(prediction.evaluate_unmasked(*angles) ** 2, axis=1)
    covariance = prediction.covariance(*angles)
    named = [_suggested(*pair) for pair in zip(omega_in, omega_out, strict=True)]
    degrees = np.array([(pair.theta_in_deg, pair.theta_out_deg, pair.phi_deg) for pair in named])
    free, chosen = np.ones(len(named)), list[SuggestedPair]()
    while len(chosen) < N_SUGGESTED and free.any():
        gain = free * (squared @ covariance**2) / (np.diag(covariance) + prediction.noise_variance)
        best = int(np.argmax(gain))
        chosen.append(named[best])
        free[np.abs(degrees - degrees[best]).max(axis=1) < _MIN_PAIR_DISTANCE_DEG] = 0.0
        column = covariance[:, best]
        covariance = covariance - np.outer(column, column) / (column[best] + prediction.noise_variance)
    return tuple(chosen)


def _suggested(omega_in: Array, omega_out: Array) -> SuggestedPair:
    """Return a pair of directions in whole degrees; phi is the azimuth between the directions."""
    theta_in, theta_out = (float(np.rint(np.degrees(np.arccos(omega[2])))) for omega in (omega_in, omega_out))
    turn = np.arctan2(omega_out[1], omega_out[0]) - np.arctan2(omega_in[1], omega_in[0])
    return SuggestedPair(
        theta_in, theta_out, float(np.rint(np.degrees(np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi))))
    )
