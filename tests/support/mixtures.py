"""Synthetic materials made of known lobes, and what the automatic fit makes of them."""

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.reduction import profiles
from dsbrdf.data.synthetic import model_measurement
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.model.dsbrdf import DSBRDF

Array = NDArray[np.float64]

NOISE = 0.02
"""Relative standard deviation of every sample."""
HALF_WIDTHS = np.radians([1.5, 8.0, 50.0])
"""Of the hemi-EPD lobes at normal incidence [rad]; a seed changes each by up to a fifth."""
HEIGHTS = np.array([30.0, 3.0, 0.3])
"""At normal incidence [1/sr]; a seed changes each by up to a factor of 2, and gives it a colour."""
KNOTS = np.radians([0.0, 45.0, 89.0])


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
        KNOTS,
        amplitude=height,
        kappa=kappa[None],
        gamma=gamma[None],
        elongation=random.uniform(0.2, 1.0, (1, n_lobes)),
    )


def choose(n_lobes: int, seed: int) -> tuple[int, int]:
    """Return the numbers of lobes and of ring lobes that the default fit chooses for a mixture."""
    data = profiles(model_measurement(mixture(n_lobes, seed), noise=NOISE, seed=seed))
    model = fit(data, FitOptions(n_lobes="auto", ring_lobes="auto")).model
    rings = int(np.count_nonzero(model.is_ring))
    return model.n_lobes - rings, rings
