"""Define the types of arrays."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
Evaluate = Callable[[Array, Array, Array], Array]
"""Function that returns values (n, 3) [1/sr] at the angles theta_half, theta_diff and phi_diff (n,) [rad]."""
