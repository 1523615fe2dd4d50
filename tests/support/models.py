"""A model of every magnitude, to be written and read."""

from dataclasses import fields

import numpy as np

from dsbrdf import DSBRDF
from dsbrdf.model import MAX_CENTER
from dsbrdf.model.splines import n_control_values

TEXTS = ("interpolation", "lobe")
ARRAYS = tuple(field.name for field in fields(DSBRDF) if field.name not in TEXTS)


def make_model(n_lobes: int = 3, n_knots: int = 5, interpolation: str = "spline") -> DSBRDF:
    """Parameters of every magnitude, with all 53 bits in use; one shape for each channel unless it is a spline."""
    random = np.random.default_rng(n_lobes)
    spline = interpolation == "spline"
    count = n_control_values if spline else int
    n_shape_knots, n_elongation_knots = n_knots + 1, 2
    shape = (1 if spline else 3, count(n_shape_knots), n_lobes)

    def knots(number: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return np.sort(random.uniform(0.0, np.pi / 2, number))

    return DSBRDF(
        theta_diff=knots(n_knots),
        amplitude=10.0 ** random.uniform(-300.0, 300.0, (3, count(n_knots), n_lobes)),
        kappa=10.0 ** random.uniform(-300.0, 2.8, shape),
        gamma=10.0 ** random.uniform(-320.0, 100.0, shape),
        center=random.uniform(-MAX_CENTER, MAX_CENTER, shape),
        elongation=random.uniform(-10.0, 10.0, (count(n_elongation_knots), n_lobes)),
        shape_theta_diff=knots(n_shape_knots),
        elongation_theta_diff=knots(n_elongation_knots),
        delta=10.0 ** random.uniform(-300.0, 300.0, (3, n_knots)),
        interpolation=interpolation,
        lobe="student" if spline else "hemi_epd",
    )


def assert_same_bits(got: DSBRDF, expected: DSBRDF) -> None:
    for name in ARRAYS:
        first, second = getattr(got, name), getattr(expected, name)
        assert first.shape == second.shape
        assert first.tobytes() == second.tobytes()
    for name in TEXTS:
        assert getattr(got, name) == getattr(expected, name)
