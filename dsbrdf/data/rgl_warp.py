"""The warps of the RGL material database: densities on the unit square that are linear between nodes.

A slice is a table of a density, bilinear between its nodes, that maps uniform samples to points with that density: the
row first, by its marginal, then the column within it.  Dupuy and Jakob, "An adaptive parameterization for efficient
material acquisition and rendering", 2018, section 4.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Warp", "bilinear"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Warp:
    """One slice.

    Attributes
    ----------
    density : ndarray, shape (H, W)
        Normalised; 1 for a uniform one.
    conditional : ndarray, shape (H, W)
        Integral of each row up to each column.
    marginal : ndarray, shape (H,)
        Integral up to each row, 0 to 1.
    """

    density: Array
    conditional: Array
    marginal: Array

    @classmethod
    def of(cls, table: ArrayLike) -> "Warp":
        """Return the warp of a table (H, W) of zero or positive values, not all of them 0."""
        density = np.asarray(table, dtype=np.float64)
        height, width = density.shape
        conditional = _running(density) / (width - 1)
        marginal = _running(conditional[:, -1]) / (height - 1)
        total = marginal[-1]
        return cls(density / total, conditional / total, marginal / total)

    def sample(self, columns: Array, rows: Array) -> tuple[Array, Array]:
        """Points (x, y) that uniform samples are mapped to, along the columns and rows; all of shape (n,)."""
        height, width = self.density.shape
        row = np.clip(np.searchsorted(self.marginal, rows, side="right") - 1, 0, height - 2)
        ends = self.conditional[:, -1]
        down = _invert_linear(ends[row], ends[row + 1], (rows - self.marginal[row]) * (height - 1))
        mixed = (1.0 - down)[:, None] * self.conditional[row] + down[:, None] * self.conditional[row + 1]
        target = columns * mixed[:, -1]
        column = np.clip(np.sum(mixed <= target[:, None], axis=1) - 1, 0, width - 2)
        left, right = (
            (1.0 - down) * self.density[row, column + i] + down * self.density[row + 1, column + i] for i in (0, 1)
        )
        rest = (target - np.take_along_axis(mixed, column[:, None], axis=1)[:, 0]) * (width - 1)
        across = _invert_linear(left, right, rest)
        return (column + across) / (width - 1), (row + down) / (height - 1)


def bilinear(table: Array, x: Array, y: Array) -> Array:
    """Values of a table (..., H, W) between its nodes at points (n,) of the unit square, x along the columns."""
    height, width = table.shape[-2:]
    column = np.clip((x * (width - 1)).astype(np.intp), 0, width - 2)
    row = np.clip((y * (height - 1)).astype(np.intp), 0, height - 2)
    across, down = x * (width - 1) - column, y * (height - 1) - row
    upper = (1.0 - across) * table[..., row, column] + across * table[..., row, column + 1]
    lower = (1.0 - across) * table[..., row + 1, column] + across * table[..., row + 1, column + 1]
    return (1.0 - down) * upper + down * lower


def _running(values: Array) -> Array:
    """Running integral along the last axis, linear between nodes one apart, 0 at the first."""
    steps = np.cumsum(0.5 * (values[..., 1:] + values[..., :-1]), axis=-1)
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), steps], axis=-1)


def _invert_linear(start: Array, end: Array, area: Array) -> Array:
    """Share t of a cell at which the integral of a density that runs from start to end reaches an area."""
    slope = end - start
    root = np.sqrt(np.maximum(start * start + 2.0 * area * slope, 0.0))
    below = start + root  # the stable form of (root - start) / slope
    return np.clip(np.where(below > 0.0, 2.0 * area / np.where(below > 0.0, below, 1.0), 0.0), 0.0, 1.0)
