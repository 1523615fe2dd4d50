"""Types of the arrays that the library computes with."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
Evaluate = Callable[[Array, Array, Array], Array]
"""Values (n, 3) [1/sr] of the angles theta_half, theta_diff and phi_diff (n,) [rad]."""
