"""What several tests with Hypothesis share, and how many examples they are given."""

import numpy as np
from hypothesis import settings

from dsbrdf import DSBRDF

SPECIAL = (np.nan, np.inf, -np.inf, -1.0, -0.0, 0.0, 5e-324, 1.7e308, 1.5e11, -1.7e308)

MODEL = DSBRDF(
    theta_diff=np.array([0.0, 0.7, 1.5]),
    amplitude=np.full((3, 5, 2), 0.3),
    kappa=np.full((1, 1, 2), 0.3),
    gamma=np.full((1, 1, 2), 4.0),
    elongation=np.array([[0.5, -0.5]]),
    shape_theta_diff=np.zeros(1),
    delta=np.zeros((3, 3)),
)


def examples(share: float) -> settings:
    """Return settings with a multiple of the number of examples that the profile has."""
    return settings(max_examples=max(1, round(share * settings().max_examples)))
