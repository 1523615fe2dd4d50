"""How far a fit of scattered samples is from the material: at samples that no fit saw, and expected at all directions.

At a sample left out, the fit is taken to be what it is there, times the ratio of the prediction without the sample and
the prediction with it. Over all directions the expected error is that of a prediction with its uncertainty, at pairs of
which half are where the model reflects and half are anywhere.

The directions to measure next are those that lower the expected squared error over these pairs most, one after another.
"""

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import half_difference, random_directions
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.fitting.report import LeftOutErrors, SuggestedPair
from dsbrdf.fitting.sample_prediction import SamplePrediction, expected_squared_error, left_out_predictions
from dsbrdf.model.dsbrdf import DSBRDF

BANDS = np.radians([0.0, 30.0, 60.0, 75.0, 90.0])
"""Bands of theta_out [rad]."""
MIRROR = np.radians(10.0)
"""Samples are near the mirror direction where theta_half is below this [rad]."""
N_SUGGESTED = 20
_N_PAIRS, _N_CANDIDATES = 2000, 700
_LAST_COSINE = float(np.cos(np.radians(80.0)))
_LEAST_STEP = 4.0  # in one of the three angles, between pairs that are named [degrees]
_LEAST_ANGLE = np.cos(np.radians(8.0))  # between light and viewer: instruments stand in their own way


def relative_rms(values: Array, expected: Array, weight: Array) -> float | None:
    """Root of the weighted squared error (n, 3) as a share of the squared signal; None without a signal."""
    signal = float(np.sum(weight[:, np.newaxis] * expected**2))
    return float(np.sqrt(np.sum(weight[:, np.newaxis] * (values - expected) ** 2) / signal)) if signal > 0.0 else None


def left_out_errors(
    samples: ScatteredSamples, prediction: SamplePrediction, model: DSBRDF, cutoff: float | None
) -> tuple[float | None, tuple[LeftOutErrors, ...]]:
    """Errors at samples left out: of all within the cutoff, of bands of theta_out, and near the mirror direction.

    The samples are those of the prediction.
    """
    angles = half_difference(samples.omega_in, samples.omega_out)
    dark = prediction.layers.dark
    ratio = (left_out_predictions(samples, prediction) + dark) / (prediction.evaluate_unmasked(*angles) + dark)
    values = model.evaluate_unmasked(*angles) * ratio
    theta_in, theta_out = (np.arccos(np.minimum(omega[:, 2], 1.0)) for omega in (samples.omega_in, samples.omega_out))
    within = np.maximum(theta_in, theta_out) <= (np.pi / 2 if cutoff is None else cutoff) + 1e-9
    places = {
        f"theta_out from {low:.0f} to {high:.0f} degrees": (theta_out >= np.radians(low))
        & (theta_out < np.radians(high))
        for low, high in zip(np.degrees(BANDS[:-1]), np.degrees(BANDS[1:]), strict=True)
    }
    places[f"theta_half below {np.degrees(MIRROR):.0f} degrees"] = angles[0] < MIRROR
    found = (
        (where, int(np.count_nonzero(chosen)), relative_rms(values, samples.values, samples.weight * chosen))
        for where, chosen in places.items()
    )
    rows = tuple(LeftOutErrors(where, count, error) for where, count, error in found if error is not None)
    return relative_rms(values, samples.values, samples.weight * within), rows


def expected_error(prediction: SamplePrediction, model: DSBRDF) -> tuple[float, tuple[SuggestedPair, ...]]:
    """Expected relative_rms over all directions, and the pairs to measure next, the most useful first."""
    omega_in, omega_out = _pairs(model)
    angles = half_difference(omega_in, omega_out)
    squared = np.sum(prediction.evaluate_unmasked(*angles) ** 2, axis=1)
    error = squared * expected_squared_error(prediction.spread(*angles))
    apart = np.flatnonzero(np.sum(omega_in * omega_out, axis=1) < _LEAST_ANGLE)
    candidates = apart[:: _N_PAIRS // _N_CANDIDATES]
    covariance = prediction.covariance(*(angle[candidates] for angle in angles))
    named = [_suggested(omega_in[at], omega_out[at]) for at in candidates]
    degrees = np.array([(pair.theta_in_deg, pair.theta_out_deg, pair.phi_deg) for pair in named])
    free, chosen = np.ones(candidates.size), list[SuggestedPair]()
    while len(chosen) < N_SUGGESTED and free.any():
        gain = free * (squared[candidates] @ covariance**2) / (np.diag(covariance) + prediction.noise_variance)
        best = int(np.argmax(gain))
        chosen.append(named[best])
        free[np.abs(degrees - degrees[best]).max(axis=1) < _LEAST_STEP] = 0.0
        column = covariance[:, best]
        covariance = covariance - np.outer(column, column) / (column[best] + prediction.noise_variance)
    return float(np.sqrt(error.sum() / squared.sum())), tuple(chosen)


def _suggested(omega_in: Array, omega_out: Array) -> SuggestedPair:
    """A pair with phi_in = 0, in whole degrees."""
    theta_in, theta_out = (float(np.rint(np.degrees(np.arccos(omega[2])))) for omega in (omega_in, omega_out))
    turn = np.arctan2(omega_out[1], omega_out[0]) - np.arctan2(omega_in[1], omega_in[0])
    return SuggestedPair(
        theta_in, theta_out, float(np.rint(np.degrees(np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi))))
    )


def _pairs(model: DSBRDF) -> tuple[Array, Array]:
    """Pairs of directions up to 80 degrees from the normal, drawn anywhere or in proportion to reflected light."""
    generator = np.random.default_rng(5)
    cosines = (np.sqrt(generator.uniform(_LAST_COSINE**2, 1.0, 6 * _N_PAIRS)) for _ in range(2))
    omega_in, omega_out = (random_directions(generator, cosine) for cosine in cosines)
    light = model.evaluate_unmasked(*half_difference(omega_in, omega_out)).mean(axis=1) * omega_in[:, 2]
    lit = generator.choice(light.size, _N_PAIRS // 2, p=light / light.sum())
    chosen = np.concatenate([lit, np.arange(_N_PAIRS - lit.size)])
    return omega_in[chosen], omega_out[chosen]
