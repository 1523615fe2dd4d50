"""Models that tests share."""

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf import DSBRDF

KNOTS = np.radians([0.0, 30.0, 60.0, 80.0])
SLICES = np.radians([5.0, 20.0, 47.0, 80.0])


def random_model(seed: int = 0, n_lobes: int = 4, family: str = "hemi_epd") -> DSBRDF:
    """Lobes such as fits find: a spike, wide ones, a ring and a cusp, elongated, changing from knot to knot."""
    random = np.random.default_rng([seed, n_lobes])
    shape, center = (1, 6, n_lobes), np.zeros((1, 6, n_lobes))
    wide = np.geomspace(3e3, 1.0, n_lobes) if n_lobes else np.zeros(0)
    center[..., 1:2] = random.uniform(-0.05, 0.4, (1, 6, 1))[..., : max(n_lobes - 1, 0)]
    return DSBRDF(
        KNOTS,
        amplitude=np.exp(random.uniform(-3.0, 4.0, (3, 6, n_lobes))),
        kappa=np.exp(random.uniform(-2.0, 1.5, shape)),
        gamma=wide * np.exp(random.uniform(-0.5, 0.5, shape)),
        center=center,
        elongation=random.uniform(-0.5, 1.2, (5, n_lobes)),
        elongation_theta_diff=np.radians([0.0, 50.0, 85.0]),
        lobe=family,
    )


def papers_model(n_lobes: int = 3, knots: ArrayLike = SLICES, seed: int = 0) -> DSBRDF:
    """The paper's lobes exp(kappa cos**gamma) - 1, a shape for each channel, and its delta term."""
    random = np.random.default_rng(seed)
    shape = (3, np.size(knots), n_lobes)
    kappa = random.uniform(0.1, 6.0, shape)
    return DSBRDF(
        np.asarray(knots, float),
        amplitude=np.expm1(kappa),
        kappa=kappa,
        gamma=np.exp(random.uniform(-1.0, 9.0, shape)),
        delta=random.uniform(0.0, 2.0, shape[:2]),
        interpolation="linear",
    )
