"""The data of a fit of lobes: values and weights in rows of theta_diff."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dsbrdf.arrays import Array, Indices
from dsbrdf.data.geometry import THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import FoldedProfiles

MAX_SAMPLES_IN_BLOCK = 2400
"""Maximum samples of a block of rows; intermediate arrays of larger blocks would not fit in a processor's cache."""
MAX_SINGLE_VALUE = 1e9
"""Data whose maximum exceeds this value [1/sr], or is below its inverse, stay in double precision."""


@dataclass(frozen=True, eq=False)
class FitData:
    """Values and weights in R rows of theta_diff, N columns of theta_half and P bins of phi_diff."""

    mean: Array  # mean value of each bin [1/sr], (channels, rows, columns, bins)
    weight: Array  # weight of each bin in the fit, (channels, rows, columns, bins)
    cos2_phi: Array  # mean cos(phi_diff)**2 of each bin, (rows, columns, bins)
    theta_diff: Array  # angle of each row [rad]
    theta_half: Array  # angle of each column [rad], (columns,), or separate for each row, (rows, columns)

    @classmethod
    def select(cls, folded: FoldedProfiles, weight: Array, rows: Indices, columns: Indices) -> "FitData":
        """Take some rows of theta_diff and columns of theta_half of folded profiles, with all bins of phi_diff."""
        chosen = np.ix_(np.arange(3), rows, columns)
        cos2_phi = np.ascontiguousarray(folded.cos2_phi[np.ix_(rows, columns)])
        return cls(folded.mean[chosen], weight[chosen], cos2_phi, THETA_DIFF[rows], THETA_HALF[columns])

    @classmethod
    def from_samples(cls, values: Array, weight: Array, row: Indices, theta_half: Array, phi_diff: Array) -> "FitData":
        """Put samples (n, 3) into rows of equal theta_diff; samples of weight 0 fill up the shorter rows."""
        rows, index, counts = np.unique(row, return_inverse=True, return_counts=True)
        order = np.argsort(index, kind="stable")
        place = index[order], np.arange(row.size) - np.repeat(np.cumsum(counts) - counts, counts)
        shape = (rows.size, counts.max())
        mean, counted, cos2_phi = (np.zeros(s) for s in ((3, *shape, 1), (3, *shape, 1), (*shape, 1)))
        data = cls(mean, counted, cos2_phi, THETA_DIFF[rows], np.zeros(shape))
        data.mean[:, *place, 0], data.weight[:, *place, 0] = values[order].T, weight[order].T
        data.cos2_phi[*place, 0], data.theta_half[place] = np.cos(phi_diff[order]) ** 2, theta_half[order]
        return data

    def take_bins(self, bins: Sequence[int]) -> "FitData":
        """Return the data of some bins of phi_diff only."""
        return self._changed(lambda array: array[..., list(bins)])

    def single(self) -> "FitData":
        """Convert the data to single precision, which halves the time of sums.

        Data beyond the range of single precision, such as values in a wrong unit, stay in double precision.
        """
        if not MAX_SINGLE_VALUE**-1 < self.mean.max(initial=0.0) < MAX_SINGLE_VALUE:
            return self
        return self._changed(lambda array: array.astype(np.float32))

    def _changed(self, change: Callable[[Array], Any]) -> "FitData":
        parts: dict[str, Any] = {name: change(getattr(self, name)) for name in ("mean", "weight", "cos2_phi")}
        return replace(self, **parts)

    @cached_property
    def signal(self) -> float:
        """Weighted sum of the squared values."""
        return float(np.sum(self.weight * self.mean**2))

    @cached_property
    def rows(self) -> tuple[Array, Array]:
        """Values and weights as arrays of the shape (rows, 3, columns * bins)."""
        shape = len(self.theta_diff), 3, -1
        return self.mean.transpose(1, 0, 2, 3).reshape(shape), self.weight.transpose(1, 0, 2, 3).reshape(shape)

    @cached_property
    def squared_tangents(self) -> tuple[Array, Array]:
        """Return tan(theta_half)**2 times cos(phi_diff)**2 and sin(phi_diff)**2, each (rows, 1, columns * bins)."""
        squared = np.tan(self.theta_half).astype(self.mean.dtype)[..., None] ** 2
        shape = len(self.theta_diff), 1, -1
        return (squared * self.cos2_phi).reshape(shape), (squared * (1.0 - self.cos2_phi)).reshape(shape)

    @cached_property
    def slices(self) -> list[slice]:
        """Slices that divide the rows into blocks whose intermediate arrays fit in a processor's cache."""
        count = len(self.theta_diff)
        size = -(-count // max(1, round(self.cos2_phi.size / MAX_SAMPLES_IN_BLOCK)))
        return [slice(start, start + size) for start in range(0, count, size)]

    @cached_property
    def blocks(self) -> list["Block"]:
        """Blocks of the rows in each of `slices`, cut down to leave out most samples of weight 0."""
        counts = self.rows[1].any(axis=1)
        order, most, blocks = np.argsort(~counts, axis=1, kind="stable"), counts.sum(axis=1), []
        for rows in self.slices:
            chosen = order[rows, None, : most[rows].max()]
            arrays = (np.take_along_axis(array[rows], chosen, axis=2) for array in (*self.rows, *self.squared_tangents))
            blocks.append(Block(rows, *arrays))
        return blocks


@dataclass(frozen=True, eq=False)
class Block:
    """Neighbouring rows of theta_diff with all samples of these rows that have a weight."""

    rows: slice  # indices of the rows of this block among all rows
    mean: Array  # values [1/sr], (rows, 3, samples)
    weight: Array  # weights of the values, (rows, 3, samples)
    along: Array  # tan(theta_half)**2 cos(phi_diff)**2, (rows, 1, samples)
    across: Array  # tan(theta_half)**2 sin(phi_diff)**2, (rows, 1, samples)
