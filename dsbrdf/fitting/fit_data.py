"""Hold the data of a fit of lobes: values and weights in rows of theta_diff."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dsbrdf.arrays import Array, Indices
from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import FoldedProfiles

MAX_SAMPLES_IN_BLOCK = 2400
"""Intermediate arrays of a block with more samples would leave a processor's cache."""
MAX_SINGLE_VALUE = 1e9
"""Data beyond this value [1/sr], or below its inverse, stay in double precision."""


@dataclass(frozen=True, eq=False)
class FitData:
    """Hold values and weights in R rows of theta_diff, N columns of theta_half and P bins of phi_diff."""

    mean: Array  # (3, R, N, P)
    weight: Array  # (3, R, N, P)
    cos2_phi: Array  # (R, N, P)
    theta_diff: Array  # (R,) [rad]
    theta_half: Array  # common to all rows (N,) or separate for each row (R, N) [rad]

    @classmethod
    def select(cls, folded: FoldedProfiles, weight: Array, rows: Indices, columns: Indices) -> "FitData":
        """Take rows of theta_diff and columns of theta_half of folded profiles, with all of their bins."""
        chosen = np.ix_(np.arange(3), rows, columns)
        cos2_phi = np.ascontiguousarray(folded.cos2_phi[np.ix_(rows, columns)])
        return cls(folded.mean[chosen], weight[chosen], cos2_phi, THETA_DIFF[rows], THETA_HALF[columns])

    @classmethod
    def from_samples(cls, values: Array, weight: Array, row: Indices, theta_half: Array, phi_diff: Array) -> "FitData":
        """Put samples (n, 3) into rows of whole degrees of theta_diff, padded with samples of weight 0."""
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
        """Keep only some bins of phi_diff."""
        chosen = list(bins)
        return replace(
            self, mean=self.mean[..., chosen], weight=self.weight[..., chosen], cos2_phi=self.cos2_phi[..., chosen]
        )

    def single(self) -> "FitData":
        """Convert the data to single precision, which halves the time of sums.

        Data beyond the range of single precision, such as values in a wrong unit, stay in double precision.
        """
        if not MAX_SINGLE_VALUE**-1 < self.mean.max(initial=0.0) < MAX_SINGLE_VALUE:
            return self
        parts: dict[str, Any] = {
            name: getattr(self, name).astype(np.float32) for name in ("mean", "weight", "cos2_phi")
        }
        return replace(self, **parts)

    @cached_property
    def signal(self) -> float:
        """Weighted sum of squares."""
        return float(np.sum(self.weight * self.mean**2))

    @cached_property
    def rows(self) -> tuple[Array, Array]:
        """Values and their weights, row by row, shape (R, 3, N * P)."""
        mean, weight = (
            part.transpose(1, 0, 2, 3).reshape(len(self.theta_diff), 3, -1) for part in (self.mean, self.weight)
        )
        return mean, weight

    @cached_property
    def squared_tangents(self) -> tuple[Array, Array]:
        """Arrays (R, 1, N * P) of tan(theta_half)**2 times cos(phi_diff)**2, and times sin(phi_diff)**2."""
        squared = np.tan(self.theta_half).astype(self.mean.dtype)[..., None] ** 2
        shape = len(self.theta_diff), 1, -1
        return (squared * self.cos2_phi).reshape(shape), (squared * (1.0 - self.cos2_phi)).reshape(shape)

    @cached_property
    def slices(self) -> list[slice]:
        """Slices of the rows, so short that intermediate arrays stay in a processor's cache."""
        count = len(self.theta_diff)
        size = -(-count // max(1, round(self.cos2_phi.size / MAX_SAMPLES_IN_BLOCK)))
        return [slice(start, start + size) for start in range(0, count, size)]

    @cached_property
    def blocks(self) -> list["Block"]:
        """Rows of each slice, without samples that have no weight in any row."""
        counts = self.rows[1].any(axis=1)
        order, most, blocks = np.argsort(~counts, axis=1, kind="stable"), counts.sum(axis=1), []
        for rows in self.slices:
            chosen = order[rows, None, : most[rows].max()]
            arrays = (np.take_along_axis(array[rows], chosen, axis=2) for array in (*self.rows, *self.squared_tangents))
            blocks.append(Block(rows, *arrays))
        return blocks


@dataclass(frozen=True, eq=False)
class Block:
    """Hold neighbouring rows with all of their weighted samples."""

    rows: slice  # indices of these rows among all rows
    mean: Array  # (r, 3, n)
    weight: Array  # (r, 3, n)
    along: Array  # tan(theta_half)**2 cos(phi_diff)**2, (r, 1, n)
    across: Array  # tan(theta_half)**2 sin(phi_diff)**2, (r, 1, n)
