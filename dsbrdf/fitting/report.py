"""Define the parts of a report of a fit: frozen dataclasses, tuples and numbers, which can be compared and pickled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.fitting.lobe_search import SearchStep
from dsbrdf.model.dsbrdf import DSBRDF


@dataclass(frozen=True)
class SelectionStep:
    """Report one number of lobes in the choice by Williams' test, see `dsbrdf.paper.WilliamsRow`."""

    n_lobes: int
    e_p: float  # mean of the error E_p over the slices, see `dsbrdf.paper.paper_method`
    squared_error: float  # sum of squared errors over all samples used [1/sr^2]
    bic: float | None  # Bayesian information criterion for Gaussian errors of unknown variance; None for an exact fit
    t: float | None
    critical_value: float | None
    significant: bool


@dataclass(frozen=True)
class KnotReport:
    """Report a fit at each of D knots of theta_diff [rad] in each channel, as tables (3, D).

    For the method "paper", the slices are the knots.
    """

    theta_diff: tuple[float, ...]
    fitted: tuple[tuple[bool, ...], ...]  # whether there were data at the knot
    converged: tuple[tuple[bool, ...], ...]  # whether the fit converged before its maximum number of iterations
    iterations: tuple[tuple[int, ...], ...]
    bounds_hit: tuple[tuple[bool, ...], ...]  # whether a parameter of a lobe ended at a bound

    @classmethod
    def from_arrays(cls, theta_diff: ArrayLike, *tables: ArrayLike) -> Self:
        """Make a report from the knots (D,) and the other tables, in order, as arrays that broadcast to (3, D)."""
        knots = np.asarray(theta_diff)
        full = (np.broadcast_to(table, (3, knots.size)).tolist() for table in tables)
        return cls(tuple(knots.tolist()), *(tuple(map(tuple, table)) for table in full))


@dataclass(frozen=True, eq=False)
class FoundModel:
    """The model that a method of fitting found, and what the method adds to the `FitReport`."""

    model: DSBRDF
    knots: KnotReport
    search: tuple[SearchStep, ...] = ()
    selection: tuple[SelectionStep, ...] = ()


@dataclass(frozen=True)
class DirectionalAlbedo:
    """The fraction of light from some directions that a model reflects."""

    theta_out: tuple[float, ...]  # angles to the normal [rad]
    rgb: tuple[tuple[float, ...], ...]  # fraction of the light from each angle that is reflected, by channel


@dataclass(frozen=True)
class LeftOutErrors:
    """Report the error of a fit of scattered samples at left-out samples."""

    where: str
    n_samples: int
    relative_rms: float


@dataclass(frozen=True)
class SuggestedPair:
    """Suggest two directions for a useful next sample [degrees]; phi is the azimuth between these directions."""

    theta_in_deg: float
    theta_out_deg: float
    phi_deg: float
