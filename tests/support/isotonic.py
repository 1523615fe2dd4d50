"""Isotonic means by their definition."""

import numpy as np
from numpy.typing import NDArray


def max_min_isotonic_means(means: NDArray[np.float64]) -> NDArray[np.float64]:
    """Isotonic means by Williams' max-min formula, literally; also on batches (..., k)."""
    k = means.shape[-1]
    return np.stack(
        [
            np.max(
                [np.min([means[..., u : v + 1].mean(axis=-1) for v in range(i, k)], axis=0) for u in range(i + 1)],
                axis=0,
            )
            for i in range(k)
        ],
        axis=-1,
    )
