"""Models and reports that several tests use."""

import numpy as np

from dsbrdf.data.reduction import Profiles
from dsbrdf.fitting.metrics import on_grid
from dsbrdf.model.dsbrdf import DSBRDF

ARRAYS = ("theta_diff", "kappa", "gamma", "center", "delta")


def make_model(n_lobes: int = 3, n_knots: int = 5) -> DSBRDF:
    """Parameters of every magnitude, with all 53 bits in use."""
    generator = np.random.default_rng(n_lobes)
    shape = (3, n_knots, n_lobes)
    return DSBRDF(
        theta_diff=np.sort(generator.uniform(0.0, np.pi / 2, n_knots)),
        kappa=10.0 ** generator.uniform(-300.0, 1.0, shape),
        gamma=10.0 ** generator.uniform(-320.0, 7.0, shape),
        center=generator.uniform(0.0, np.pi / 2, shape),
        delta=generator.standard_normal((3, n_knots)) * 10.0 ** generator.uniform(-200.0, 200.0, (3, n_knots)),
    )


def assert_same_bits(got: DSBRDF, expected: DSBRDF) -> None:
    for name in ARRAYS:
        first, second = getattr(got, name), getattr(expected, name)
        assert first.shape == second.shape
        assert first.tobytes() == second.tobytes()
    assert got.interpolation == expected.interpolation


def curve_error(found: DSBRDF, truth: DSBRDF, data: Profiles) -> float:
    """Weighted relative distance of the two models on the nodes used."""
    a, b = on_grid(found), on_grid(truth)
    return float(np.sqrt(np.sum(data.weight * (a - b) ** 2) / np.sum(data.weight * b**2)))
