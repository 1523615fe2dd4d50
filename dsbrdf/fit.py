"""From a measurement, or its profiles, to a model and a report: em -> delta -> metrics.

``method="paper"`` is the procedure of Nishino 2009: Algorithm 1 on each of 18 slices of theta_diff, 5 degrees apart,
with the lobes matched across slices by sorting on kappa, and a delta term for theta_half < 1 degree.
"""

import platform
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from dsbrdf import em
from dsbrdf.errors import ConvergenceWarning, FitError, InvalidArgumentError
from dsbrdf.hemi_epd import energy, lobe
from dsbrdf.measurement import THETA_DIFF, THETA_HALF, Measurement
from dsbrdf.metrics import OUTSIDE_CENTER, mean_absolute_log_error, relative_errors
from dsbrdf.model import DSBRDF
from dsbrdf.profiles import DEFAULT_HORIZON_CUTOFF, WEIGHTINGS, Profiles, check_horizon_cutoff, profiles

Array = NDArray[np.float64]

ALGORITHM_VERSION = "1"
"""Changes whenever the same measurement and options may give another model: part of a fit's identity."""
MAX_LOBES = 8
METHODS = ("paper",)
PAPER_SLICES = np.radians(np.arange(0.0, 90.0, 5.0))
"""The 18 slices of the paper, 0 to 85 degrees [rad]."""


@dataclass(frozen=True)
class FitOptions:
    """What can be chosen about a fit; checked when made.

    Attributes
    ----------
    n_lobes : int
        Number of lobes, 1 to 8.
    method : {"paper"}
        ``paper`` is Algorithm 1 slice by slice.
    horizon_cutoff : float or None
        Samples with a direction further than this from the normal are left out [rad]; None is the horizon.
    mask : float or None
        Keep theta_half <= 90 degrees - mask * theta_diff (Nishino 2009, section 6); None is the method's own, 1 for
        ``paper``.
    weighting : {"plain", "cosine", "log"}
        Weights of the samples, see `profiles`.
    robust : bool
        Down-weight outliers: among the samples over phi_diff, and in the M-step over theta_half.
    em_iterations : int
        Bound on the iterations of Algorithm 1.

    Raises
    ------
    InvalidArgumentError
        If a choice is unknown or out of range.
    """

    n_lobes: int = 3
    method: Literal["paper"] = "paper"
    horizon_cutoff: float | None = DEFAULT_HORIZON_CUTOFF
    mask: float | None = None
    weighting: Literal["plain", "cosine", "log"] = "plain"
    robust: bool = False
    em_iterations: int = 100

    def __post_init__(self) -> None:
        if not _is_integer(self.n_lobes) or not 1 <= self.n_lobes <= MAX_LOBES:
            raise InvalidArgumentError(f"n_lobes must be an integer from 1 to {MAX_LOBES}, not {self.n_lobes!r}")
        if self.method not in METHODS:
            raise InvalidArgumentError(f"method must be one of {', '.join(METHODS)}, not {self.method!r}")
        if self.weighting not in WEIGHTINGS:
            raise InvalidArgumentError(f"weighting must be one of {', '.join(WEIGHTINGS)}, not {self.weighting!r}")
        check_horizon_cutoff(self.horizon_cutoff)
        if self.mask is not None and not 0.0 <= self.mask <= 10.0:
            raise InvalidArgumentError(f"mask must be a number from 0 to 10, not {self.mask!r}")
        if not isinstance(self.robust, bool):
            raise InvalidArgumentError(f"robust must be true or false, not {self.robust!r}")
        if not _is_integer(self.em_iterations) or not 1 <= self.em_iterations <= 10_000:
            raise InvalidArgumentError(f"em_iterations must be an integer from 1 to 10000, not {self.em_iterations!r}")


@dataclass(frozen=True)
class FitReport:
    """What a fit did and how good it is; plain numbers, lists and dicts throughout.

    Attributes
    ----------
    metrics : dict
        ``relative_rms``, ``floor``, ``excess`` (None without a floor) and ``male``; see `dsbrdf.metrics`.  Where only
        the profiles were given ``male`` is None, and all of them are if those were weighted.
    slices : dict
        ``theta_diff`` (D) [rad] and, for each channel and knot (3, D), ``fitted`` (False: no data, parameters of the
        nearest fitted slice), ``converged``, ``iterations`` and ``bounds_hit``.
    energy : dict
        ``theta_out`` [rad], ``albedo``: directional albedo there, (n, 3); ``sum_inverse_c``: the paper's sum of 1/C
        over the lobes, (3, D).
    timings : dict
        Seconds for each step.
    options : dict
        The `FitOptions` used.
    versions : dict
        Of the algorithm, this library and what it computes with.
    """

    metrics: dict[str, float | None]
    slices: dict[str, list[Any]]
    energy: dict[str, list[Any]]
    timings: dict[str, float]
    options: dict[str, Any]
    versions: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class FitResult:
    """A model and the report of its fit."""

    model: DSBRDF
    report: FitReport


def fit(
    measurement: Measurement | Profiles,
    options: FitOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> FitResult:
    """Fit the model to a measurement.

    Parameters
    ----------
    measurement : Measurement or Profiles
        Profiles must have been made with the options' horizon cutoff, weighting and robustness.
    options : FitOptions, optional
        Defaults to ``FitOptions()``.
    progress : callable, optional
        Called with the share of the work done, 0 to 1, at least once an iteration.  What it raises ends the fit and
        reaches the caller.

    Returns
    -------
    FitResult

    Raises
    ------
    FitError
        If the options leave no data to fit.
    InvalidArgumentError
        If profiles do not agree with the options.

    Warns
    -----
    ConvergenceWarning
        If slices stopped at the bound on the iterations; the report says which.
    """
    options = FitOptions() if options is None else options
    report_progress = progress if progress is not None else _ignore
    clock = _Clock()
    report_progress(0.0)
    data = _reduce(measurement, options)
    clock.lap("profiles")
    report_progress(0.1)
    model, slices = _fit_paper(data, options, lambda share: report_progress(0.1 + 0.8 * share))
    clock.lap("em")
    metrics = _metrics(model, measurement, data, options)
    clock.lap("metrics")
    report = FitReport(metrics, slices, _energy(model), clock.laps, asdict(options), _versions())
    clock.lap("energy")
    report_progress(1.0)
    if not all(np.ravel(slices["converged"])):
        count = int(np.sum(np.logical_not(slices["converged"])))
        warnings.warn(
            f"{count} slices stopped at the bound of {options.em_iterations} iterations before they converged",
            ConvergenceWarning,
            stacklevel=2,
        )
    return FitResult(model, report)


def _reduce(measurement: Measurement | Profiles, options: FitOptions) -> Profiles:
    if isinstance(measurement, Measurement):
        return profiles(
            measurement,
            horizon_cutoff=options.horizon_cutoff,
            weighting=options.weighting,
            robust=options.robust,
        )
    for name in ("horizon_cutoff", "weighting", "robust"):
        made, asked = getattr(measurement, name), getattr(options, name)
        if made != asked:
            raise InvalidArgumentError(f"the profiles were made with {name} {made!r}, the options ask for {asked!r}")
    return measurement


def _fit_paper(
    data: Profiles, options: FitOptions, progress: Callable[[float], None]
) -> tuple[DSBRDF, dict[str, list[Any]]]:
    """Algorithm 1 on the 18 slices of all channels in one batch."""
    rows = np.searchsorted(THETA_DIFF, PAPER_SLICES - 1e-9)
    mask = 1.0 if options.mask is None else options.mask
    kept = OUTSIDE_CENTER & (THETA_HALF <= np.pi / 2 - mask * PAPER_SLICES[:, None] + 1e-9)
    weight = np.where(kept, data.weight[:, rows], 0.0)
    # A slice with fewer nodes than parameters has nothing to say about them.
    fitted = np.sum(weight > 0, axis=2) >= 2 * options.n_lobes
    if not fitted.any(axis=1).all():
        raise FitError(
            "the mask and the horizon cutoff leave no slice with enough valid samples to fit: "
            "raise the horizon cutoff or lower the mask or the number of lobes"
        )
    columns = np.flatnonzero(OUTSIDE_CENTER)
    slices = em.fit_slices(
        THETA_HALF[columns],
        data.mean[:, rows][fitted][:, columns],
        weight[fitted][:, columns],
        options.n_lobes,
        iterations=options.em_iterations,
        robust=options.robust,
        on_iteration=lambda number: progress(number / options.em_iterations),
    )
    nearest = _nearest_fitted(fitted)
    kappa, gamma = _spread(slices.kappa, fitted, nearest), _spread(slices.gamma, fitted, nearest)
    delta = _delta(data, rows, kappa, gamma)
    model = DSBRDF(PAPER_SLICES, kappa, gamma, np.zeros_like(kappa), delta)
    report = {
        "theta_diff": PAPER_SLICES.tolist(),
        "fitted": fitted.tolist(),
        "converged": _spread(slices.converged, fitted, nearest).tolist(),
        "iterations": _spread(slices.iterations, fitted, nearest).tolist(),
        "bounds_hit": (_at_bounds(kappa, em.KAPPA_BOUNDS) | _at_bounds(gamma, em.GAMMA_BOUNDS)).tolist(),
    }
    return model, report


def _nearest_fitted(fitted: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Index, shape (3, D), of the fitted slice nearest to each slice of its channel; 0 if there is none."""
    index = np.arange(fitted.shape[1])
    distance = np.where(fitted[:, None, :], np.abs(index[:, None] - index), np.inf)
    return np.argmin(distance, axis=2)


def _spread(values: NDArray[Any], fitted: NDArray[np.bool_], nearest: NDArray[np.intp]) -> NDArray[Any]:
    """Values (fitted slices, ...) at all slices (3, D, ...): those without data take the nearest slice's."""
    full = np.zeros((*fitted.shape, *values.shape[1:]), values.dtype)
    full[fitted] = values
    return full[np.arange(len(fitted))[:, None], nearest]


def _delta(data: Profiles, rows: NDArray[np.intp], kappa: Array, gamma: Array) -> Array:
    """Weighted mean residual where theta_half < 1 degree, shape (3, D); without data there that of the nearest slice.

    It never takes away more than the lobes put there, so that the model stays positive.
    """
    center = np.flatnonzero(~OUTSIDE_CENTER)
    weight = data.weight[:, rows][:, :, center]
    lobes = lobe(THETA_HALF[center], kappa[..., None], gamma[..., None]).sum(axis=2)
    total = weight.sum(-1)
    residual = np.sum(weight * (data.mean[:, rows][:, :, center] - lobes), axis=-1) / np.where(total > 0, total, 1.0)
    residual = np.take_along_axis(residual, _nearest_fitted(total > 0), axis=1)
    return np.maximum(residual, -lobes.min(axis=-1))


def _at_bounds(values: Array, bounds: tuple[float, float]) -> NDArray[np.bool_]:
    """Whether any lobe of a slice stands at a bound; a vanishing or flat lobe at its lower bound is no fault."""
    return np.any(values >= bounds[1] * (1 - 1e-9), axis=2) | np.any(values <= bounds[0] * (1 + 1e-9), axis=2)


def _metrics(
    model: DSBRDF, measurement: Measurement | Profiles, data: Profiles, options: FitOptions
) -> dict[str, float | None]:
    if isinstance(measurement, Profiles):
        if data.weighting != "plain" or data.robust:
            return dict.fromkeys(("relative_rms", "floor", "excess", "male"))
        return relative_errors(model, data) | {"male": None}
    if data.weighting != "plain" or data.robust:
        data = profiles(measurement, horizon_cutoff=options.horizon_cutoff)
    male = mean_absolute_log_error(model, measurement, options.horizon_cutoff)
    return relative_errors(model, data) | {"male": male}


def _energy(model: DSBRDF) -> dict[str, list[Any]]:
    theta_out = np.radians([0.0, 15.0, 30.0, 45.0, 60.0, 75.0])
    return {
        "theta_out": theta_out.tolist(),
        "albedo": model.directional_albedo(theta_out).tolist(),
        "sum_inverse_c": energy(model.kappa, model.gamma).sum(axis=2).tolist(),
    }


def _versions() -> dict[str, str]:
    from dsbrdf import __version__

    return {
        "algorithm": ALGORITHM_VERSION,
        "dsbrdf": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "python": platform.python_version(),
    }


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _ignore(_: float) -> None:
    """No one wants to know the progress."""


class _Clock:
    """Seconds between laps."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = now - self._last
        self._last = now
