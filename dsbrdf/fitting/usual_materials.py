"""What materials are usually like, for measurements with few samples or with samples in one plane only.

`guides` are the first lobes (see `dsbrdf.fitting.first_lobes`) of 71 measured materials: 70 numbers each, whose mean
and covariance tell how heights, widths, tails and elongations usually go with theta_diff and with each other. To
samples these lobes are fitted with the relative error `_MISFIT` that they have on whole measurements, against that
prior; how bright a material is, the prior leaves open.

The fit of the samples then gets `N_PAIRS` values of this usual material more, each counting `_WEIGHT` of a sample:
where there are samples they outweigh them, elsewhere nothing else says what the material is like.
"""

from functools import cache
from importlib.resources import files

import numpy as np
from scipy.spatial import cKDTree

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import half_difference, random_directions
from dsbrdf.data.grid import THETA_DIFF
from dsbrdf.data.merl_validation import LARGEST_VALUE
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.fitting.first_lobes import first_structure
from dsbrdf.fitting.least_squares import FitData, MixtureProblem, Prior, minimize
from dsbrdf.fitting.structure import Mixture, Structure, mixture_model
from dsbrdf.model.dsbrdf import DSBRDF

STORED = files("dsbrdf.fitting") / "usual_materials.npz"
"""The file of the unknowns of `guides`, and of the names of their materials."""
N_PAIRS = 800
"""Pairs of directions at which the usual material completes the samples."""
FAR = np.radians(10.0)
"""A direction without a sample within this angle is extrapolated to [rad]."""
_WEIGHT = 0.02
_MISFIT = 0.08  # relative error of the readable lobes
_DARK = 0.02  # of the median over samples of the channels' mean, which relative errors are at least relative to
_SHRINK, _LEAST_VARIANCE, _VARIANCE_OF_LEVEL = 0.05, 1e-3, 25.0
_N_STARTS, _TOLERANCE, _ITERATIONS = 3, 1e-4, 100
_LAST_COSINE = float(np.cos(np.radians(80.0)))


@cache
def guides() -> Array:
    """Unknowns of the readable lobes of measured materials, shape (71, 70)."""
    with STORED.open("rb") as file, np.load(file) as stored:
        return np.asarray(stored["unknowns"], dtype=np.float64)


def usual_material(samples: ScatteredSamples) -> tuple[DSBRDF, float]:
    """Fit the readable lobes to samples, against what materials are usually like.

    Returns the model, and its cost for each sample, of squared relative errors and of the prior, in units of the usual.
    """
    known, data = guides(), _relative_rows(samples)
    structure = first_structure()
    prior = _prior(known, structure, data.signal)
    problem = MixtureProblem(data, structure, (0.0, 0.0, 0.0), prior)
    starts = np.array([_at_level_of(problem, unknowns) for unknowns in known])
    costs = [problem.evaluate(structure.limit(unknowns)).cost for unknowns in starts]
    found = (
        minimize(problem, starts[place], tolerance=_TOLERANCE, iterations=_ITERATIONS)
        for place in np.argsort(costs)[:_N_STARTS]
    )
    best = min(found, key=lambda solution: solution.cost)
    usual_cost = 3.0 * _MISFIT**2 * len(samples.values)
    return mixture_model(Mixture(structure, best.unknowns)), best.cost / usual_cost


def with_usual_values(samples: ScatteredSamples, model: DSBRDF) -> tuple[ScatteredSamples, float]:
    """Complete samples with `N_PAIRS` values of the model of `usual_material`.

    Returns the completed samples, and the share of the pairs that have no sample within `FAR`.
    """
    omega_in, omega_out = _pairs(model)
    values = np.clip(model.evaluate_directions(omega_in, omega_out), 0.0, LARGEST_VALUE)
    distance, _ = cKDTree(_places(samples.omega_in, samples.omega_out)).query(_places(omega_in, omega_out))
    typical = float(np.median(samples.weight))
    completed = ScatteredSamples.from_arrays(
        np.concatenate([samples.omega_in, omega_in]),
        np.concatenate([samples.omega_out, omega_out]),
        np.concatenate([samples.values, values]),
        np.concatenate([samples.weight, np.full(N_PAIRS, _WEIGHT * typical)]),
        samples.name,
    )
    return completed, float(np.mean(distance > FAR))


def typical_error(model: DSBRDF, samples: ScatteredSamples) -> float:
    """Median relative error of a model on samples, of the means over the channels."""
    found = model.evaluate_directions(samples.omega_in, samples.omega_out).mean(axis=1)
    values = samples.values.mean(axis=1)
    return float(np.median(np.abs(found - values) / (values + _DARK * np.median(values) + 1e-12)))


def _pairs(model: DSBRDF) -> tuple[Array, Array]:
    """Pairs of directions up to 80 degrees from the normal: half of them where a model reflects, half anywhere."""
    generator = np.random.default_rng(5)
    cosines = (np.sqrt(generator.uniform(_LAST_COSINE**2, 1.0, N_PAIRS)) for _ in range(2))
    omega_in, omega_out = (random_directions(generator, cosine) for cosine in cosines)
    reflected = model.sample(omega_out[: N_PAIRS // 2], generator).omega_in
    used = np.flatnonzero(reflected[:, 2] > _LAST_COSINE)
    omega_in[used] = reflected[used]
    return omega_in, omega_out


def _places(omega_in: Array, omega_out: Array) -> Array:
    """Points whose distance is about the angle between pairs, the same for a pair turned, mirrored or swapped [rad]."""
    theta_half, theta_diff, phi_diff = half_difference(omega_in, omega_out)
    folded = np.arccos(np.abs(np.cos(phi_diff)))
    return np.stack([theta_diff, theta_half * np.cos(folded), theta_half * np.sin(folded)], axis=-1)


def _relative_rows(samples: ScatteredSamples) -> FitData:
    """Samples in rows of whole degrees of theta_diff, weighted so that relative errors count alike."""
    theta_half, theta_diff, phi_diff = half_difference(samples.omega_in, samples.omega_out)
    row = np.minimum(np.rint(np.degrees(theta_diff)).astype(np.intp), THETA_DIFF.size - 1)
    level = samples.values + _DARK * np.median(samples.values.mean(axis=1)) + 1e-12
    weight = samples.weight[:, None] / samples.weight.mean() / level**2
    return FitData.from_samples(samples.values, weight, row, theta_half, phi_diff)


def _prior(known: Array, structure: Structure, signal: float) -> Prior:
    """Mean and covariance of the known materials, in the units of a `Prior`; the level is free."""
    covariance = np.cov(known.T)
    covariance += _SHRINK * np.diag(np.diag(covariance)) + _LEAST_VARIANCE * np.eye(len(covariance))
    level = _levels(structure)
    covariance += _VARIANCE_OF_LEVEL * np.outer(level, level)
    matrix = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    return Prior(matrix * (_MISFIT**2 / signal), np.asarray(known.mean(axis=0)))


def _levels(structure: Structure) -> Array:
    """1 for each unknown that is a log amplitude."""
    level = np.zeros(structure.n_unknowns)
    structure.split(level)[0][...] = 1.0
    return level


def _at_level_of(problem: MixtureProblem, unknowns: Array) -> Array:
    """Unknowns with all amplitudes changed by the factor that fits the data best."""
    values, data = problem.values(unknowns), problem.data
    factor = np.sum(data.weight * data.mean * values) / max(float(np.sum(data.weight * values**2)), 1e-300)
    return unknowns + np.log(max(factor, 1e-12)) * _levels(problem.structure)
