"""Synthetic materials made of known lobes, and what the automatic fit makes of them."""

from dataclasses import replace
from io import BytesIO
from unittest.mock import patch

import numpy as np

from dsbrdf import DSBRDF, FitOptions, ScatteredSamples, fit, profiles
from dsbrdf.arrays import Array
from dsbrdf.data import CHANNELS, model_measurement
from dsbrdf.data.geometry import random_directions
from dsbrdf.model import half_width, sampling
from dsbrdf.samples.names import VECTORS

COARSE_ANGLES = sampling.ANGLES[::10]
"""Every 15th degree: densities tabulated there are near enough for tests, and found in a tenth of the time."""
NOISE = 0.02
"""Relative standard deviation of every sample."""
HALF_WIDTHS = np.radians([1.5, 8.0, 50.0])
"""Of the hemi-EPD lobes at normal incidence [rad]; a seed changes each by up to a fifth."""
HEIGHTS = np.array([30.0, 3.0, 0.3]) / np.pi
"""At normal incidence [1/sr]; a seed changes each by up to a factor of 2, and gives it a colour; no light is gained."""
KNOTS = np.radians([0.0, 45.0, 89.0])
CHECKED_ANGLES = np.radians([0.0, 30.0, 60.0, 75.0])
"""theta_diff at which parameters are compared [rad]."""


def mixture(n_lobes: int, seed: int) -> DSBRDF:
    """Material of 1 to 3 well separated lobes, coloured and elongated, that change smoothly with theta_diff."""
    random = np.random.default_rng([seed, n_lobes])
    chosen = np.sort(random.permutation(HALF_WIDTHS.size)[:n_lobes])
    share = np.linspace(0.0, 1.0, KNOTS.size + 2)[:, None]
    colour = 2.0 ** random.uniform(-0.7, 0.7, (3, 1, n_lobes))
    height = HEIGHTS[chosen] * 2.0 ** random.uniform(-1.0, 1.0, n_lobes) * colour
    height = height * np.exp(random.uniform(0.0, 1.4, n_lobes) * share**2)
    width = HALF_WIDTHS[chosen] * (1.0 + 0.2 * random.uniform(-1.0, 1.0, n_lobes))
    kappa = random.uniform(0.7, 3.0, n_lobes) * np.ones_like(share)
    gamma = np.log(np.log1p(np.expm1(kappa) / 2.0) / kappa) / np.log(np.cos(width))
    gamma = gamma * np.exp(random.uniform(-0.3, 0.3, n_lobes) * share)
    return DSBRDF(
        KNOTS, amplitude=height, kappa=kappa[None], gamma=gamma[None], elongation=random.uniform(0.2, 1.0, (1, n_lobes))
    )


def scattered_samples(model: DSBRDF, count: int, seed: int = 1) -> ScatteredSamples:
    """Return samples of a model without noise at `scattered_directions`."""
    omega_in, omega_out = scattered_directions(model, count, seed)
    return ScatteredSamples.from_arrays(
        omega_in, omega_out, model.evaluate_directions(omega_in, omega_out), name="known"
    )


def samples_table(samples: ScatteredSamples) -> bytes:
    file, columns = BytesIO(), np.hstack([samples.omega_in, samples.omega_out, samples.values])
    np.savetxt(file, columns, "%.17g", ",", header=",".join((*VECTORS, *CHANNELS)), comments="")
    return file.getvalue()


def scattered_directions(model: DSBRDF, count: int, seed: int) -> tuple[Array, Array]:
    """Return pairs of directions, shapes (count, 3): half of them where a model reflects, half anywhere."""
    random = np.random.default_rng(seed)
    omega_in, omega_out = (random_directions(random, np.sqrt(random.uniform(0.02, 1.0, count))) for _ in ("in", "out"))
    with patch.object(sampling, "ANGLES", COARSE_ANGLES):
        where = replace(model).sample(omega_out[: count // 2], random)[0]
    above = np.flatnonzero(where[:, 2] > 0.05)
    omega_in[above] = where[above]
    return omega_in, omega_out


def found_by_fit(n_lobes: int, seed: int) -> DSBRDF:
    data = profiles(model_measurement(mixture(n_lobes, seed), noise=NOISE, seed=seed))
    return fit(data, FitOptions()).model


def numbers_of_lobes(model: DSBRDF) -> tuple[int, int]:
    rings = int(np.count_nonzero(model.is_ring))
    return model.n_lobes - rings, rings


def deviations(model: DSBRDF, truth: DSBRDF) -> dict[str, float]:
    """Largest relative deviations of a model's parameters, for as many lobes, at `CHECKED_ANGLES`.

    An elongation does nothing at theta_diff = 0 and is left out there.
    """
    parts = []
    for one in (model, truth):
        found = one.parameters_at(CHECKED_ANGLES)
        width = half_width(found["kappa"], found["gamma"], model.lobe)
        order = np.argsort(width[0, 0])
        parts.append(
            {name: found[name][..., order] for name in ("amplitude", "kappa", "gamma")}
            | {"half width": width[..., order], "elongation": found["elongation"][1:, order]}
        )
    return {name: float(np.max(np.abs(parts[0][name] / parts[1][name] - 1.0))) for name in parts[0]}
