"""Models that several tests use."""

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.geometry import above_horizon
from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles
from dsbrdf.model.dsbrdf import DSBRDF

Array = NDArray[np.float64]

ARRAYS = (
    "theta_diff",
    "amplitude",
    "kappa",
    "gamma",
    "center",
    "elongation",
    "shape_theta_diff",
    "elongation_theta_diff",
    "delta",
)


def make_model(n_lobes: int = 3, n_knots: int = 5, interpolation: str = "spline", lobe: str = "hemi_epd") -> DSBRDF:
    """Parameters of every magnitude, with all 53 bits in use."""
    random = np.random.default_rng(n_lobes)
    n_values = n_knots + 2 if interpolation == "spline" else n_knots
    shape = (1, n_values, n_lobes)
    knots = np.sort(random.uniform(0.0, np.pi / 2, n_knots))
    return DSBRDF(
        theta_diff=knots,
        amplitude=10.0 ** random.uniform(-300.0, 300.0, (3, n_values, n_lobes)),
        kappa=10.0 ** random.uniform(-300.0, 1.0, shape),
        gamma=10.0 ** random.uniform(-320.0, 7.0, shape),
        center=random.uniform(-np.pi / 2, np.pi / 2, shape),
        elongation=random.uniform(-2.0, 2.0, (n_values, n_lobes)),
        elongation_theta_diff=knots,
        delta=10.0 ** random.uniform(-200.0, 200.0, (3, n_knots)),
        interpolation=interpolation,
        lobe=lobe,
    )


def assert_same_bits(got: DSBRDF, expected: DSBRDF) -> None:
    for name in ARRAYS:
        first, second = getattr(got, name), getattr(expected, name)
        assert first.shape == second.shape
        assert first.tobytes() == second.tobytes()
    assert (got.interpolation, got.lobe) == (expected.interpolation, expected.lobe)


def on_grid(model: DSBRDF) -> Array:
    """Values at phi_diff = 90 degrees, in the order of the profiles, shape (3, 90, 90)."""
    return np.moveaxis(model.evaluate(THETA_HALF, THETA_DIFF[:, None]), -1, 0)


def profile_of(model: DSBRDF, data: Profiles) -> Array:
    """Means over phi_diff of the nodes that the profiles use, shape (3, 90, 90)."""
    cutoff = np.pi / 2 if data.horizon_cutoff is None else data.horizon_cutoff
    table, used = model.tabulate(), above_horizon(THETA_HALF[:, None, None], THETA_DIFF[:, None], PHI_DIFF, cutoff)
    mean = (table * used).sum(axis=3) / np.maximum(used.sum(axis=2), 1)
    return np.asarray(mean.swapaxes(1, 2))


def curve_error(found: DSBRDF, truth: DSBRDF, data: Profiles) -> float:
    """Weighted relative distance of the two models on the nodes used."""
    a, b = profile_of(found, data), profile_of(truth, data)
    return float(np.sqrt(np.sum(data.weight * (a - b) ** 2) / np.sum(data.weight * b**2)))
