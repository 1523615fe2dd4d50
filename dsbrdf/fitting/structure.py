"""Which lobes a mixture has, how its unknowns lie in one array, and where they may lie."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import THETA_HALF
from dsbrdf.model.lobes import gamma_of_half_width, half_width
from dsbrdf.model.splines import n_control_values, spline_basis

Array = NDArray[np.float64]

LOG_AMPLITUDE_BOUNDS = (-25.0, 18.5)
"""From nothing to the largest value that a measurement may have."""
KAPPA_BOUNDS = (1e-2, 10.0)
GAMMA_BOUNDS = (1e-2, 5e4)
"""From flat to a sixth of a degree, about the narrowest peak that the grid resolves."""
CENTER_BOUNDS = (-0.25, float(np.pi / 2))
ELONGATION_BOUNDS = (-2.0, 2.0)
RESOLVED = 1.0
"""A half width is at least this many times the spacing of the data at the center of the lobe."""
CUSP_WIDTHS = 1.0
"""A negative center is at most this many half widths: a cusp stays about as steep as the lobe itself."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Which lobes there are and where their parameters have knots; fixes the layout of the unknowns.

    Attributes
    ----------
    rings : tuple of bool
        For each lobe whether it has a center; those that have come last.
    amplitude_knots, shape_knots, elongation_knots : ndarray
        Angles theta_diff [rad].
    family : str
        One of `dsbrdf.model.lobes.FAMILIES`.
    theta_half : ndarray
        Angles with data [rad]: what is narrower than their spacing would only fit the gaps between them.
    """

    rings: tuple[bool, ...]
    amplitude_knots: Array
    shape_knots: Array
    elongation_knots: Array
    family: str
    theta_half: Array = field(default_factory=lambda: THETA_HALF)

    @property
    def n_lobes(self) -> int:
        """Number K of lobes."""
        return len(self.rings)

    @property
    def n_rings(self) -> int:
        """Number of lobes that have a center."""
        return sum(self.rings)

    @property
    def n_unknowns(self) -> int:
        """How many numbers describe the mixture."""
        return sum(rows * columns for rows, columns in self._blocks)

    @property
    def _blocks(self) -> tuple[tuple[int, int], ...]:
        """Control values and parameters of amplitudes, shapes and elongations."""
        count = [n_control_values(k.size) for k in (self.amplitude_knots, self.shape_knots, self.elongation_knots)]
        k = self.n_lobes
        return (count[0], 3 * k), (count[1], 2 * k + self.n_rings), (count[2], k)

    def split(self, unknowns: Array) -> tuple[Array, Array, Array]:
        """Views on the unknowns.

        Returns
        -------
        amplitude : ndarray, shape (D, 3 K)
            Logarithms, channel by channel.
        shape : ndarray, shape (S, 2 K + rings)
            log kappa, log gamma, center of the ring lobes.
        elongation : ndarray, shape (E, K)
        """
        ends = np.cumsum([rows * columns for rows, columns in self._blocks])
        parts = np.split(unknowns, ends[:-1])
        amplitude, shape, elongation = (p.reshape(block) for p, block in zip(parts, self._blocks, strict=True))
        return amplitude, shape, elongation

    def is_kappa(self) -> NDArray[np.bool_]:
        """Which unknowns are logarithms of kappa, shape (n_unknowns,)."""
        found = np.zeros(self.n_unknowns)
        self.split(found)[1][:, : self.n_lobes] = 1.0
        return found > 0.0

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the unknowns, shape (n_unknowns,) each."""
        sides = []
        for side in (0, 1):
            bound = np.empty(self.n_unknowns)
            amplitude, shape, elongation = self.split(bound)
            k = self.n_lobes
            amplitude[...] = LOG_AMPLITUDE_BOUNDS[side]
            shape[:, :k], shape[:, k : 2 * k] = np.log(KAPPA_BOUNDS[side]), np.log(GAMMA_BOUNDS[side])
            shape[:, 2 * k :], elongation[...] = CENTER_BOUNDS[side], ELONGATION_BOUNDS[side]
            sides.append(bound)
        return sides[0], sides[1]

    def limit(self, unknowns: Array) -> Array:
        """Unknowns within the bounds, no lobe narrower than the data can tell and no cusp steeper than its lobe.

        A half width is at least `RESOLVED` times the spacing of the data at the lobe's center, and a negative center at
        most `CUSP_WIDTHS` half widths.
        """
        limited = np.clip(unknowns, *self.bounds())
        shape, k = self.split(limited)[1], self.n_lobes
        center = np.zeros((len(shape), k))
        center[:, list(self.rings)] = np.maximum(shape[:, 2 * k :], 0.0)
        if self.theta_half.size > 1:
            middle = 0.5 * (self.theta_half[1:] + self.theta_half[:-1])
            narrowest = RESOLVED * np.interp(center, middle, np.diff(self.theta_half))
            steepest = gamma_of_half_width(np.minimum(narrowest, 1.0), np.exp(shape[:, :k]), self.family)
            np.minimum(shape[:, k : 2 * k], np.log(steepest), out=shape[:, k : 2 * k])
        width = half_width(np.exp(shape[:, :k]), np.exp(shape[:, k : 2 * k]), self.family)[:, list(self.rings)]
        np.maximum(shape[:, 2 * k :], -CUSP_WIDTHS * width, out=shape[:, 2 * k :])
        return limited


def change_knots(old: Structure, unknowns: Array, new: Structure) -> Array:
    """Unknowns of the same mixture on other knots: exact where the old knots are among the new ones."""
    changed = np.empty(new.n_unknowns)
    knots = ("amplitude_knots", "shape_knots", "elongation_knots")
    for name, part, into in zip(knots, old.split(unknowns), new.split(changed), strict=True):
        first, last = getattr(new, name)[[0, -1]]
        angles = np.linspace(first, last, 8 * len(into))
        values = spline_basis(getattr(old, name), angles) @ part
        into[...] = np.linalg.lstsq(spline_basis(getattr(new, name), angles), values, rcond=None)[0]
    return changed
