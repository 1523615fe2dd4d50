"""Prepare scattered samples for the fit, and estimate the error of the fit.

A prediction from the samples (`dsbrdf.samples.prediction`) fills a table over theta_diff, theta_half and phi_diff,
which is fitted like a measured table. The last fit adds each sample at its own angles, except that theta_diff is moved
to the nearest whole degree. All samples together weigh as much as the whole table, or less if they are few. A node of
the table near a sample weighs less than other nodes, because the sample replaces it.

To fit again without each sample would be too slow. Instead, the value of the fit at a sample left out is the fitted
value times the ratio of two predictions: one made without the sample, and one with it.

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

from dsbrdf.arrays import Array, Indices
from dsbrdf.data.geometry import (
    CENTER_CUTOFF,
    PHI_DIFF,
    QUARTER,
    THETA_DIFF,
    THETA_HALF,
    above_horizon,
    directions,
    half_difference,
    incident_cosines,
    spherical,
)
from dsbrdf.data.reduction import N_BINS, SAMPLES_IN_BIN, FoldedProfiles, Profiles
from dsbrdf.fitting.fit_data import FitData
from dsbrdf.fitting.global_method import FIT_COLUMNS, FIT_ROWS, USED_COLUMNS, USED_ROWS, fit_weights
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import LeftOutErrors, SuggestedPair
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.samples.prediction import SamplePrediction, left_out_predictions, thinned
from dsbrdf.samples.sample_layers import dark_level
from dsbrdf.samples.scattered_samples import ScatteredSamples

# A node of the table gets half weight if its uncertainty equals this relative error, the smallest that lobes reach.
_MODEL_ERROR = 0.015
# A node of the table keeps at least this fraction of its weight, however near to samples or uncertain the node is.
_MIN_NODE_WEIGHT = 1e-3
# Fewer samples weigh less than the table, by the square of their number: else their noise distorts the model elsewhere.
_MIN_FULL_WEIGHT_SAMPLES = 1000
# The value of a sample changes by at most this factor when the sample moves to the nearest whole degree of theta_diff.
_MAX_MOVE_RATIO = 16.0


def predicted_profiles(samples: ScatteredSamples, prediction: SamplePrediction, options: FitOptions) -> Profiles:
    """Return the table that is predicted from samples, at the theta_diff and theta_half that a fit uses."""
    cells = np.stack([axis.ravel() for axis in np.meshgrid(USED_ROWS, USED_COLUMNS, np.arange(N_BINS), indexing="ij")])
    # The weight of each phi_diff from 0 to 90 degrees in each cell, (cells, 91); 0 below the horizon.
    row, column, bin_of = cells
    above = above_horizon(THETA_HALF[column, np.newaxis], THETA_DIFF[row, np.newaxis], PHI_DIFF[:QUARTER])
    count = SAMPLES_IN_BIN.T[bin_of] * above
    cells, count = cells[:, count.any(axis=1)], count[count.any(axis=1)]
    total = count.sum(axis=1)
    squared_cosine = count @ np.cos(PHI_DIFF[:QUARTER]) ** 2 / total
    angles = THETA_HALF[cells[1]], THETA_DIFF[cells[0]], np.arccos(np.sqrt(squared_cosine))
    shape = (THETA_DIFF.size, THETA_HALF.size, N_BINS)
    weight, mean, cos2_phi = np.zeros((3, *shape)), np.zeros((3, *shape)), np.zeros(shape)
    weight[:, *cells], cos2_phi[*cells] = total, squared_cosine
    mean[:, *cells] = prediction.evaluate_unmasked(*angles).T
    over_phi = weight.sum(axis=3)
    level = np.sum(weight * mean, axis=3) / np.where(over_phi > 0.0, over_phi, 1.0)
    within = np.sum(weight * (mean - level[..., np.newaxis]) ** 2, axis=3)
    made = (options.horizon_cutoff, "plain", options.robust)
    folded = FoldedProfiles(mean, weight, cos2_phi)
    return Profiles(level, over_phi, within, folded, *made, samples.name, samples.sha256)


def sample_rows(
    samples: ScatteredSamples, table: Profiles, options: FitOptions, prediction: SamplePrediction, model: DSBRDF
) -> FitData:
    """Return the data of a fit: the samples, moved to whole degrees of theta_diff, and the table predicted from them.

    When a sample moves, its value is multiplied by the ratio of the model's values at the new and the old theta_diff.
    Two samples have the same ratio of weights as the nodes of the predicted table at their angles. But the many nodes
    within `CENTER_CUTOFF` of the mirror direction weigh little each, while a sample there is often the only one of the
    peak: it weighs as much as a sample at the cutoff.
    """
    weight, folded = fit_weights(table, options), table.folded
    cells = np.stack(np.nonzero(folded.weight[0])).astype(np.intp)
    cells = cells[:, np.isin(cells[0], FIT_ROWS) & np.isin(cells[1], FIT_COLUMNS)]
    predicted, counted = folded.mean[:, *cells], weight[:, *cells]
    each = weight / np.where(folded.weight > 0.0, folded.weight, 1.0)
    theta_half, theta_diff, phi_diff = half_difference(samples.omega_in, samples.omega_out)
    at_sample = each[:, *_cells(np.maximum(theta_half, CENTER_CUTOFF), theta_diff, phi_diff)] * samples.weight
    row = _nearest(THETA_DIFF, theta_diff)
    there, here = (model.evaluate_unmasked(theta_half, angle, phi_diff) for angle in (THETA_DIFF[row], theta_diff))
    values = samples.values * np.clip(there / np.maximum(here, 1e-300), 1.0 / _MAX_MOVE_RATIO, _MAX_MOVE_RATIO)
    sample_weight = np.sum(counted * predicted**2) / max(float(np.sum(at_sample * values.T**2)), 1e-300)
    sample_weight *= min(1.0, len(samples.values) / _MIN_FULL_WEIGHT_SAMPLES) ** 2
    nodes = THETA_HALF[cells[1]], THETA_DIFF[cells[0]], np.arccos(np.sqrt(folded.cos2_phi[*cells]))
    spread, remote = prediction.spread(*nodes), prediction.remoteness(*nodes, samples)
    counted = counted * np.maximum(remote * _MODEL_ERROR**2 / (_MODEL_ERROR**2 + spread**2), _MIN_NODE_WEIGHT)
    return FitData.from_samples(
        np.concatenate([values, predicted.T]),
        np.concatenate([sample_weight * at_sample.T, counted.T]),
        np.concatenate([row, cells[0]]),
        np.concatenate([theta_half, nodes[0]]),
        np.concatenate([phi_diff, nodes[2]]),
    )


def _cells(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Indices:
    """Return the indices of theta_diff, theta_half and bin of phi_diff in the table for each sample, shape (3, n)."""
    row = FIT_ROWS[_nearest(THETA_DIFF[FIT_ROWS], theta_diff)]
    column = FIT_COLUMNS[_nearest(np.sqrt(THETA_HALF[FIT_COLUMNS]), np.sqrt(theta_half))]
    turned = np.degrees(phi_diff) % 180.0
    folded_phi = np.minimum(turned, 180.0 - turned)
    return np.stack([row, column, np.rint(folded_phi).astype(np.intp) // 10])


def _nearest(axis: Array, angles: Array) -> Indices:
    """Return, for each of `angles`, the index of the nearest angle of the ascending `axis`."""
    return np.searchsorted(0.5 * (axis[1:] + axis[:-1]), angles)


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
# Values below this fraction of the largest are equally dark when errors of logarithms are compared.
_MIN_COMPARED_FRACTION = 1e-6
# A sample is unconfirmed only if its squared error is more than this fraction of the sum over all samples.
_UNCONFIRMED_FRACTION = 0.5
_MAX_SINE_IN_PLANE = np.sin(np.radians(0.5))  # Directions this near the plane of incidence lie in the plane.
# Suggested directions are at least 8 degrees apart, because light and detector of an instrument would cover each other.
_MAX_COSINE_BETWEEN = np.cos(np.radians(8.0))
_SAME_COSINE = 1e-5  # Cosines that are equal after rounding to this step count as equal.


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
    dark = dark_level(samples) + _MIN_COMPARED_FRACTION * float(samples.values.max())
    off = np.log((samples.values.mean(axis=1) + dark) / (values.mean(axis=1) + dark))
    at = int(np.argmax(np.abs(off)))
    if np.abs(off[at]) > _UNCONFIRMED_LOG and off[at] ** 2 > _UNCONFIRMED_FRACTION * np.sum(off**2):
        theta_in, theta_out, phi = _pair_degrees(samples.omega_in[[at]], samples.omega_out[[at]])[0]
        yield (
            f"Much depends on one sample, at theta_in = {theta_in:.0f}, theta_out = {theta_out:.0f} "
            f"and phi = {phi:.0f} degrees: it is {np.exp(off[at]):.2g} times what a fit without it has there; "
            "measure near it again, or leave it out if it is wrong."
        )


def left_out_errors(
    samples: ScatteredSamples, values: Array, cutoff: float | None
) -> tuple[float | None, tuple[LeftOutErrors, ...]]:
    """Return the errors of the `left_out_values`: in total within the cutoff, and separately for groups of samples."""
    theta_half = np.degrees(half_difference(samples.omega_in, samples.omega_out)[0])
    # The cosine of 30 degrees is inexact: without rounding, this angle would be in the band below.
    theta_out = np.degrees(np.arccos(samples.omega_out[:, 2])).round(6)
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
    """Return errors of a model at samples: `male` at all samples, the others within the cutoff."""
    weight = _weight_within(samples, horizon_cutoff)
    fitted, cosine = model.evaluate_directions(samples.omega_in, samples.omega_out), samples.omega_in[:, 2:]
    log_error = np.abs(np.log1p(samples.values * cosine) - np.log1p(fitted * cosine))
    return Metrics(
        relative_rms=relative_rms(fitted, samples.values, weight),
        symmetric_floor=_symmetric_floor(samples, weight),
        male=float(np.average(log_error.mean(axis=1), weights=samples.weight)),
    )


def _symmetric_floor(samples: ScatteredSamples, weight: Array) -> float | None:
    """Return the smallest `relative_rms` of any reciprocal isotropic model; None if no samples are symmetric.

    Samples are symmetric if their directions have equal cosines to the normal, in any order, and to each other.
    """
    first, second = samples.omega_in, samples.omega_out
    cosines = np.stack([*np.sort([first[:, 2], second[:, 2]], axis=0), np.sum(first * second, axis=1)])
    steps = np.rint((1.0 + cosines) / _SAME_COSINE).astype(np.intp)
    place, count = np.unique(
        np.ravel_multi_index(tuple(steps), 3 * (round(2.0 / _SAME_COSINE) + 1,)),
        return_inverse=True,
        return_counts=True,
    )[1:]
    if count.max() == 1:
        return None
    sums = np.stack([np.bincount(place, weight * channel) for channel in samples.values.T], axis=1)
    mean = sums / np.maximum(np.bincount(place, weight), 1e-300)[:, np.newaxis]
    return relative_rms(mean[place], samples.values, weight)


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


def pairs_to_measure(
    prediction: SamplePrediction,
    model: DSBRDF,
    step_deg: float = 1.0,
    max_theta_deg: float = 90.0,
    *,
    in_plane: bool = False,
) -> tuple[SuggestedPair, ...]:
    """Return pairs of directions to measure next, the most useful first.

    Their angles are multiples of `step_deg`, those to the normal at most `max_theta_deg`; optionally all pairs lie in
    one plane.
    """
    nodes, weight, cosine = _nodes()
    light = weight * cosine * model.evaluate_unmasked(*nodes).mean(axis=1)
    generator = np.random.default_rng(5)
    drawn = [generator.choice(light.size, _N_CANDIDATES // 2, p=p / p.sum()) for p in (light, weight)]
    degrees = _pair_degrees(*directions(*(angle[np.unique(drawn)] for angle in nodes)))
    if in_plane:
        degrees[:, 2] = np.where(degrees[:, 2] > 90.0, 180.0, 0.0)
    degrees = np.unique(np.rint(degrees / step_deg) * step_deg, axis=0)
    degrees = degrees[degrees[:, :2].max(axis=1) <= max_theta_deg]
    theta_in, theta_out, phi = np.radians(degrees).T
    omega_in, omega_out = spherical(theta_in, np.zeros_like(phi)), spherical(theta_out, phi)
    far = np.sum(omega_in * omega_out, axis=1) < _MAX_COSINE_BETWEEN
    omega_in, omega_out, degrees = omega_in[far], omega_out[far], degrees[far]
    angles = half_difference(omega_in, omega_out)
    squared = np.sum(prediction.evaluate_unmasked(*angles) ** 2, axis=1)
    covariance = prediction.covariance(*angles)
    free, chosen = np.ones(len(degrees)), list[SuggestedPair]()
    while len(chosen) < N_SUGGESTED and free.any():
        gain = free * (squared @ covariance**2) / (np.diag(covariance) + prediction.noise_variance)
        best = int(np.argmax(gain))
        chosen.append(SuggestedPair(*degrees[best].tolist()))
        free[np.abs(degrees - degrees[best]).max(axis=1) < _MIN_PAIR_DISTANCE_DEG] = 0.0
        column = covariance[:, best]
        covariance = covariance - np.outer(column, column) / (column[best] + prediction.noise_variance)
    return tuple(chosen)


def planned_pairs(
    samples: ScatteredSamples, model: DSBRDF, step_deg: float, max_theta_deg: float
) -> tuple[SuggestedPair, ...]:
    """Return pairs of directions to measure next; they lie in one plane if all samples do."""
    _, theta_out, phi = np.radians(_pair_degrees(samples.omega_in, samples.omega_out)).T
    in_plane = bool(np.all(np.abs(np.sin(phi)) * np.sin(theta_out) < _MAX_SINE_IN_PLANE))
    prediction = SamplePrediction.fit(thinned(samples))
    return pairs_to_measure(prediction, model, step_deg, max_theta_deg, in_plane=in_plane)


def _pair_degrees(omega_in: Array, omega_out: Array) -> Array:
    """Return theta_in, theta_out and the azimuth between directions (n, 3) [degrees], shape (n, 3)."""
    theta_in, theta_out = (np.arccos(np.clip(omega[:, 2], -1.0, 1.0)) for omega in (omega_in, omega_out))
    turn = np.arctan2(omega_out[:, 1], omega_out[:, 0]) - np.arctan2(omega_in[:, 1], omega_in[:, 0])
    return np.degrees(np.stack([theta_in, theta_out, np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi)], axis=1))
