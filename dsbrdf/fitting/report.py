"""Hold the result of a fit: the model and a report of the search and of its errors.

A report consists of frozen dataclasses, tuples and numbers, so that reports can be compared, hashed and pickled.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array
from dsbrdf.fitting.lobe_search import SearchStep
from dsbrdf.fitting.metrics import BandErrors, ChannelErrors, Metrics
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.version import Versions


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
    """Hold the model that a method of fitting found, and what the method adds to the `FitReport`."""

    model: DSBRDF
    knots: KnotReport
    search: tuple[SearchStep, ...] = ()
    selection: tuple[SelectionStep, ...] = ()


@dataclass(frozen=True)
class DirectionalAlbedo:
    """Hold the fraction of light from some directions that a model reflects."""

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


@dataclass(frozen=True, repr=False)
class FitReport:
    """Report the course and the errors of a fit.

    Attributes
    ----------
    warnings : tuple of str
        Sentences of `dsbrdf.report_warnings`, which a user should read before using the model; sentences about the
        components are in the `remarks` of `dsbrdf.decompose`.
    metrics : Metrics
        Metrics of the fit; all are None if only profiles were fitted.
    by_channel, by_theta_diff : tuple of ChannelErrors, tuple of BandErrors
        Errors of each channel that is not black, and of each band of theta_diff with data; empty without metrics.
    knots : KnotReport
        How the fit went at each knot of theta_diff.
    search, selection : tuple of SearchStep, tuple of SelectionStep
        Mixtures of lobes that the method "global" tried; numbers of lobes that the method "paper" compared.
    directional_albedo, n_numbers : DirectionalAlbedo, int
        Fraction of the light that the model reflects, and how many numbers the model stores.
    timings : dict of str to float
        Time of each step, by its name [s].
    options, versions : FitOptions, Versions
        Options of the fit, and versions of the algorithm, this library and the packages that it computes with.
    left_out, measure_next : tuple of LeftOutErrors, tuple of SuggestedPair
        For scattered samples only: errors at samples that were left out, and directions to measure next, the most
        useful pair first. There are no pairs unless the error expected over all directions is large.
    samples : str or None
        Digest of the scattered samples, see `dsbrdf.ScatteredSamples`; None for a measurement on a grid.
    """

    warnings: tuple[str, ...]
    metrics: Metrics
    by_channel: tuple[ChannelErrors, ...]
    by_theta_diff: tuple[BandErrors, ...]
    knots: KnotReport
    search: tuple[SearchStep, ...]
    selection: tuple[SelectionStep, ...]
    directional_albedo: DirectionalAlbedo
    n_numbers: int
    timings: dict[str, float] = field(hash=False)
    options: FitOptions
    versions: Versions
    left_out: tuple[LeftOutErrors, ...] = ()
    measure_next: tuple[SuggestedPair, ...] = ()
    samples: str | None = None

    def __repr__(self) -> str:
        error = self.metrics.relative_rms
        accuracy = "no metrics" if error is None else f"relative_rms {error:.4g}"
        count = len(self.warnings)
        return f"<FitReport: {accuracy}, {self.n_numbers} numbers, {count} {'warning' if count == 1 else 'warnings'}>"

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain dicts, lists, texts and numbers, keyed by the names of its attributes."""
        content: dict[str, Any] = _plain(asdict(self))
        return content


@dataclass(frozen=True)
class FitResult:
    """Hold a model and the report of its fit.

    A result can be drawn, decomposed, saved and evaluated like its model, as in `dsbrdf.render_sphere(result)`.

    Attributes
    ----------
    model : DSBRDF
    report : FitReport
    """

    model: DSBRDF
    report: FitReport

    def evaluate(self, theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike = np.pi / 2) -> Array:
        """Return RGB values of the model, shape (..., 3) [1/sr], at angles [rad]; see `DSBRDF.evaluate`."""
        return self.model.evaluate(theta_half, theta_diff, phi_diff)


def _plain(value: Any) -> Any:
    """Return dicts and tuples converted to the types of JSON."""
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
