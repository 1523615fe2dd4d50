"""Synthetic materials made of known lobes, and what the automatic number of lobes makes of them."""

import numpy as np

from dsbrdf.data.reduction import profiles
from dsbrdf.data.synthetic import model_measurement
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.model.dsbrdf import DSBRDF

NOISE = 0.02
"""Relative standard deviation of every sample."""
HALF_WIDTHS = np.radians([1.5, 8.0, 50.0])
"""At normal incidence [rad]; a seed changes each by up to a fifth."""
PEAKS = np.array([30.0, 3.0, 0.3])
"""At normal incidence [1/sr]; a seed changes each by up to a factor of 2."""
_KNOTS = np.radians(np.arange(0.0, 90.0, 5.0))


def mixture(n_lobes: int, seed: int) -> DSBRDF:
    """Material of 1 to 3 well separated lobes that change smoothly with theta_diff and a little with the channel."""
    random = np.random.default_rng([seed, n_lobes])
    chosen = np.sort(random.permutation(HALF_WIDTHS.size)[:n_lobes])
    grazing = (1.0 - np.cos(_KNOTS))[:, None]
    channel = 1.0 + 0.2 * random.uniform(-1.0, 1.0, (3, 1, n_lobes))
    peak = PEAKS[chosen] * 2.0 ** random.uniform(-1.0, 1.0, n_lobes) * channel
    peak = peak * (1.0 + random.uniform(0.0, 3.0, n_lobes) * grazing**2)
    width = HALF_WIDTHS[chosen] * (1.0 + 0.2 * random.uniform(-1.0, 1.0, n_lobes))
    width = width * (1.0 + random.uniform(-0.2, 0.2, n_lobes) * grazing) * np.ones((3, 1, 1))
    kappa = np.log1p(peak)
    gamma = np.log(np.log1p(peak / 2.0) / kappa) / np.log(np.cos(width))
    return DSBRDF(_KNOTS, kappa, gamma, np.zeros_like(kappa), np.zeros((3, _KNOTS.size)))


def choose(n_lobes: int, seed: int) -> tuple[int, int]:
    """Return the numbers of lobes and of ring lobes that the default fit chooses for a mixture."""
    data = profiles(model_measurement(mixture(n_lobes, seed), noise=NOISE, seed=seed))
    model = fit(data, FitOptions(n_lobes="auto", ring_lobes="auto")).model
    rings = int(np.any(model.center > 0, axis=(0, 1)).sum())
    return model.n_lobes - rings, rings
