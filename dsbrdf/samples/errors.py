"""How far a fit of scattered samples is from the material: at samples that no fit saw, and expected at all directions.

At a sample left out, the fit is taken to be what it is there, times the ratio of the prediction without the sample and
the prediction with it. Over all directions the expected error has three parts: the median of the errors that the model
would have if the material were one of the layers that are as probable; the factor that samples leave open; the usual
misfit of layers. Each is an integral over pairs of directions, half of them where the material reflects and half of
them anywhere, and is calibrated on materials of known truth.

The directions to measure next are those that lower the expected squared error most, one after another.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import half_difference, random_directions
from dsbrdf.fitting.report import LeftOutErrors, SuggestedPair
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.samples.prediction import SamplePrediction, left_out_predictions
from dsbrdf.samples.sample_layers import dark_level
from dsbrdf.samples.scattered_samples import ScatteredSamples

THETA_OUT_BANDS = np.radians([0.0, 30.0, 60.0, 75.0, 90.0])
"""Bands of theta_out [rad]."""
MIRROR = np.radians(10.0)
"""Samples are near the mirror direction where theta_half is below this [rad]."""
N_SUGGESTED = 20
_N_DRAWN_PAIRS = 24_000
_N_CANDIDATES = 700
# A variance of the logarithm of a value counts up to here.
_MAX_LOG_VARIANCE = 1.0
# Factors of the three parts of the expected error, so that the true one is larger in one of ten tables: 96 tables of
# twelve materials, half of them measured and half of them formulas, 50 to 1,000 samples in one plane and all around.
_CALIBRATION = np.array([2.2, 1.0, 1.5])
# Layers that miss the samples by more are as far from the material between them as usual ones are.
_DOUBTFUL_LAYER_ERROR = 0.12
_LAST_COSINE = float(np.cos(np.radians(80.0)))
# Two pairs that are suggested differ by at least this in one of the three angles.
_MIN_PAIR_DISTANCE_DEG = 4.0
# A sample is unconfirmed if a fit without it misses its logarithm by more, with most of the squared errors.
_UNCONFIRMED_LOG = np.log(3.0)
_UNCONFIRMED_FRACTION = 0.5
# Instruments stand in their own way where light and viewer are nearer than 8 degrees.
_MAX_COSINE_BETWEEN = np.cos(np.radians(8.0))


def relative_rms(values: Array, expected: Array, weight: Array) -> float | None:
    """Root of the weighted squared error (n, 3) as a share of the squared signal; None without a signal."""
    signal = float(np.sum(weight[:, np.newaxis] * expected**2))
    return float(np.sqrt(np.sum(weight[:, np.newaxis] * (values - expected) ** 2) / signal)) if signal > 0.0 else None


def left_out_values(samples: ScatteredSamples, prediction: SamplePrediction, model: DSBRDF) -> Array:
    """Values (n, 3) of a fit without each of the samples of the prediction [1/sr]."""
    angles = half_difference(samples.omega_in, samples.omega_out)
    dark = prediction.layers.dark
    ratio = (left_out_predictions(samples, prediction) + dark) / (prediction.likely(*angles) + dark)
    return model.evaluate_unmasked(*angles) * ratio


def unconfirmed_sample(samples: ScatteredSamples, values: Array) -> Iterator[str]:
    """Name the sample that others do not confirm, if most of the error at samples left out is that of one."""
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
    """Errors of `left_out_values`: of all within the cutoff, of bands of theta_out, and near the mirror direction."""
    angles = half_difference(samples.omega_in, samples.omega_out)
    theta_in, theta_out = (np.arccos(np.minimum(omega[:, 2], 1.0)) for omega in (samples.omega_in, samples.omega_out))
    within = np.maximum(theta_in, theta_out) <= (np.pi / 2 if cutoff is None else cutoff) + 1e-9
    places = {
        f"theta_out from {low:.0f} to {high:.0f} degrees": (theta_out >= np.radians(low))
        & (theta_out < np.radians(high))
        for low, high in zip(np.degrees(THETA_OUT_BANDS[:-1]), np.degrees(THETA_OUT_BANDS[1:]), strict=True)
    }
    places[f"theta_half below {np.degrees(MIRROR):.0f} degrees"] = angles[0] < MIRROR
    found = (
        (where, int(np.count_nonzero(chosen)), relative_rms(values, samples.values, samples.weight * chosen))
        for where, chosen in places.items()
    )
    rows = tuple(LeftOutErrors(where, count, error) for where, count, error in found if error is not None)
    return relative_rms(values, samples.values, samples.weight * within), rows


def expected_error(prediction: SamplePrediction, model: DSBRDF) -> float:
    """Return the relative_rms over all directions that the error of one to two tables in ten exceeds."""
    angles, weight, cosine = _nodes()
    layers = prediction.layers
    values = model.evaluate_unmasked(*angles) + layers.dark
    unknown = prediction.unknown_share(*angles)
    drawn = layers.drawn_logs(*angles) - np.log(layers.evaluate_unmasked(*angles) + layers.dark)

    def relative(true: Array, error: Array) -> float:
        light = weight * cosine * true.mean(axis=1)
        counted = light / light.sum() + weight / weight.sum()
        return float(np.sqrt(np.sum(counted * error) / np.sum(counted * np.sum(true**2, axis=1))))

    trues = values * np.exp(np.sqrt(unknown)[:, np.newaxis] * drawn)
    of_layers = float(np.median([relative(true, np.sum((values - true) ** 2, axis=1)) for true in trues]))
    # Layers that explain the samples to their noise are as true between them.
    doubt = min(1.0, (layers.found[0].error / _DOUBTFUL_LAYER_ERROR) ** 2)
    variances = unknown * prediction.variance, unknown * layers.misfit(*angles) ** 2
    square = np.sum(values**2, axis=1)
    of_factor, of_misfit = (
        relative(values, square * np.expm1(np.minimum(variance, _MAX_LOG_VARIANCE))) for variance in variances
    )
    parts = np.array([of_layers, of_factor, doubt * of_misfit])
    return float(np.linalg.norm(_CALIBRATION * parts))


@cache
def _nodes() -> tuple[tuple[Array, Array, Array], Array, Array]:
    """Angles of pairs up to 80 degrees from the normal, what each counts among all, and the cosine of theta_in."""
    edges = np.concatenate([[0.0], np.geomspace(5e-4, np.pi / 2.0, 32)]), np.linspace(0.0, np.pi / 2.25, 21)
    middle_half, middle_diff = (0.5 * (edge[1:] + edge[:-1]) for edge in edges)
    measure = np.diff(-np.cos(edges[0]))[:, np.newaxis, np.newaxis] * np.diff(np.sin(edges[1]) ** 2)[:, np.newaxis]
    half, diff, phi = np.meshgrid(middle_half, middle_diff, (np.arange(4) + 0.5) * np.pi / 8.0, indexing="ij")
    level, swing = np.cos(half) * np.cos(diff), np.sin(half) * np.sin(diff) * np.cos(phi)
    seen = level - np.abs(swing) >= _LAST_COSINE
    weight = measure * (level**2 - swing**2)
    return (half[seen], diff[seen], phi[seen]), weight[seen], (level - swing)[seen]


def pairs_to_measure(prediction: SamplePrediction, model: DSBRDF) -> tuple[SuggestedPair, ...]:
    """Pairs of directions to measure next, the most useful first."""
    omega_in, omega_out, _, light = _drawn(model)
    lit = np.random.default_rng(5).choice(light.size, _N_CANDIDATES // 2, p=light / light.sum())
    chosen_at = np.concatenate([lit, np.arange(_N_CANDIDATES - lit.size)])
    chosen_at = chosen_at[np.sum(omega_in[chosen_at] * omega_out[chosen_at], axis=1) < _MAX_COSINE_BETWEEN]
    omega_in, omega_out = omega_in[chosen_at], omega_out[chosen_at]
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
    """A pair with phi_in = 0, in whole degrees."""
    theta_in, theta_out = (float(np.rint(np.degrees(np.arccos(omega[2])))) for omega in (omega_in, omega_out))
    turn = np.arctan2(omega_out[1], omega_out[0]) - np.arctan2(omega_in[1], omega_in[0])
    return SuggestedPair(
        theta_in, theta_out, float(np.rint(np.degrees(np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi))))
    )


def _drawn(model: DSBRDF) -> tuple[Array, Array, Array, Array]:
    """Random omega_in and omega_out within 80 degrees of the normal, a model's values, and the light it reflects."""
    generator = np.random.default_rng(5)
    cosines = (np.sqrt(generator.uniform(_LAST_COSINE**2, 1.0, _N_DRAWN_PAIRS)) for _ in range(2))
    omega_in, omega_out = (random_directions(generator, cosine) for cosine in cosines)
    values = model.evaluate_unmasked(*half_difference(omega_in, omega_out))
    return omega_in, omega_out, values, values.mean(axis=1) * omega_in[:, 2]
