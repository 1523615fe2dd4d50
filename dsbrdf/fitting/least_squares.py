"""Global least squares over all rows of the profiles.

Unknowns are log kappa, log gamma and, for ring lobes, center, of every lobe at every knot; between knots they follow
the spline of `dsbrdf.model.splines`, which is linear in the unknowns: ``parameters(row) = sum_d B[row, d] x[d]``.
With the analytic derivatives J of the lobes with respect to the parameters of a row,

    normal equations  A = sum_row (B B^T) x (J^T W J) + smoothing,     gradient  b = sum_row B x (J^T W r),

so that a whole measurement costs one small product per row.  Each channel is a problem of its own; they iterate
together.  The method is Levenberg-Marquardt with the damping update of Nielsen (1999, IMM-REP-1999-05) and bounds:
an unknown that stands at a bound and is pushed outwards is held.  No lobe may peak higher than four times the largest
value measured around its knot.

Two weak pulls decide what the data leave open, the shape of a lobe where it is hardly visible: smoothing over knots,
`SMOOTHING` times the squared signal for each squared second difference, and agreement between the channels, `COUPLING`
times the squared signal for each squared distance of log gamma and center from the channels' mean at the start.  The
second keeps a lobe the same lobe in every channel, so that components have a colour.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.fitting.em import GAMMA_BOUNDS, KAPPA_BOUNDS
from dsbrdf.model.splines import CENTER_OVERSHOOT, OVERSHOOT, roughness, spline_basis

Array = NDArray[np.float64]

SMOOTHING = 1e-7
COUPLING = 1e-6
ALL_COLUMNS = np.arange(THETA_HALF.size)
CENTER_BOUNDS = (0.0, np.pi / 2)
_LARGEST_EXPONENT = 60.0  # a spline may overshoot kappa's bound between knots: keep squares finite
_PEAK_ROOM = 4.0
_LARGEST_STEP = 2.0  # in log parameters and radians
_LARGEST_DAMPING = 1e8


@dataclass(frozen=True)
class Lobes:
    """How many lobes of either kind; fixes the layout (P,) of the unknowns of a knot.

    log kappa of all lobes, then log gamma of all lobes, then center of the ring lobes; centered lobes come first.
    """

    centered: int
    rings: int = 0

    @property
    def count(self) -> int:
        """Number of lobes."""
        return self.centered + self.rings

    @property
    def n_parameters(self) -> int:
        """Number P of unknowns of a knot."""
        return 2 * self.count + self.rings

    def bounds(self, largest_kappa: Array) -> tuple[Array, Array]:
        """Bounds of the unknowns, each (3, D, P), for the largest kappa (3, D) at each knot."""
        low, high = np.empty((2, *largest_kappa.shape, self.n_parameters))
        for array, side in ((low, 0), (high, 1)):
            kappas, gammas, centers = self.split(array)
            kappas[...] = np.log(KAPPA_BOUNDS[0] if side == 0 else largest_kappa[..., None])
            gammas[...], centers[...] = np.log(GAMMA_BOUNDS[side]), CENTER_BOUNDS[side]
        return low, high

    def split(self, unknowns: Array) -> tuple[Array, Array, Array]:
        """Views on log kappa, log gamma (..., count) and center (..., rings)."""
        n = self.count
        return unknowns[..., :n], unknowns[..., n : 2 * n], unknowns[..., 2 * n :]


@dataclass(frozen=True, eq=False)
class FitData:
    """Profiles with the weights that the fit gives them.

    Attributes
    ----------
    mean, weight, within : ndarray, shape (3, 90, 90)
        As in `Profiles`; weight 0 for what is masked.
    peak : ndarray, shape (3, 90)
        Largest value of each row [1/sr]; bounds kappa.
    """

    mean: Array
    weight: Array
    within: Array
    peak: Array


class ProfileProblem:
    """Profiles on chosen rows and columns, ready for least squares.

    Parameters
    ----------
    data : FitData
    knots, rows : ndarray of int
        Rows of the theta_diff axis: where the knots stand, and which to fit.
    columns : ndarray of int, optional
        Columns of theta_half to fit; all of them by default.
    smoothing, coupling : float, optional
        See the module.
    """

    def __init__(
        self,
        data: FitData,
        knots: NDArray[np.intp],
        rows: NDArray[np.intp],
        columns: NDArray[np.intp] = ALL_COLUMNS,
        smoothing: float = SMOOTHING,
        coupling: float = COUPLING,
    ) -> None:
        chosen = np.ix_(np.arange(3), rows, columns)
        mean, weight, within = data.mean[chosen], data.weight[chosen], data.within[chosen]
        self.theta_half = THETA_HALF[columns]
        self.log_cos = np.log(np.cos(self.theta_half))
        self.knots, self.rows = knots, rows
        self.mean, self.weight = mean, weight
        self.root = np.sqrt(self.weight)
        self.data = self.root * self.mean
        self.floor = within.sum(axis=(1, 2))
        signal = np.einsum("crn,crn->c", self.data, self.data) + self.floor
        self.signal = np.where(signal > 0, signal, 1.0)  # a black channel is fitted absolutely
        self.largest_kappa = _largest_kappa(data.peak, knots)
        self.basis = spline_basis(THETA_DIFF[knots], THETA_DIFF[rows])
        self.smoothing = smoothing * roughness(np.degrees(THETA_DIFF[knots]))
        self.coupling = coupling
        pairs = self.basis[:, :, None] * self.basis[:, None, :]
        self._pairs = np.ascontiguousarray(pairs.reshape(rows.size, -1).T)

    def residuals(self, lobes: Lobes, unknowns: Array, channels: NDArray[np.intp] | None = None) -> Array:
        """Weighted residuals (channels, rows, N) for unknowns (channels, D, P)."""
        residual, _ = self._evaluate(lobes, unknowns, _all(unknowns, channels), derivatives=False)
        return residual

    def squared_error(self, lobes: Lobes, unknowns: Array) -> Array:
        """Weighted squared error of the profiles per channel, without the floor."""
        residual = self.residuals(lobes, unknowns)
        return np.asarray(np.einsum("crn,crn->c", residual, residual))

    def linearize(
        self, lobes: Lobes, unknowns: Array, anchor: Array, channels: NDArray[np.intp]
    ) -> tuple[Array, Array, Array]:
        """Cost (C,), normal matrix (C, D P, D P) and gradient (C, D P), with the pulls towards smoothness and anchor.

        The anchor (D, P) counts for log gamma and center.
        """
        residual, jacobian = self._evaluate(lobes, unknowns, channels, derivatives=True)
        c, d, p = unknowns.shape
        rows = residual.shape[1]
        products = jacobian @ np.swapaxes(jacobian, 2, 3)
        normal = (self._pairs @ products.reshape(c, rows, p * p)).reshape(c, d, d, p, p)
        normal = np.ascontiguousarray(normal.transpose(0, 1, 3, 2, 4))
        smoothing = self.signal[channels, None, None] * self.smoothing
        each = np.arange(p)
        normal[:, :, each, :, each] += smoothing
        gradient = np.einsum("rd,crp->cdp", self.basis, (jacobian @ residual[..., None])[..., 0])
        pull = smoothing @ unknowns
        cost = np.einsum("crn,crn->c", residual, residual) + np.einsum("cdp,cdp->c", unknowns, pull)
        strength = self.coupling * self.signal[channels]
        shape = slice(lobes.count, None)
        apart = unknowns[:, :, shape] - anchor[:, shape]
        cost += strength * np.einsum("cdp,cdp->c", apart, apart)
        pull[:, :, shape] += strength[:, None, None] * apart
        for k in range(lobes.count, p):
            normal[:, np.arange(d), k, np.arange(d), k] += strength[:, None]
        return cost, normal.reshape(c, d * p, d * p), (gradient + pull).reshape(c, d * p)

    def _evaluate(
        self, lobes: Lobes, unknowns: Array, channels: NDArray[np.intp], *, derivatives: bool
    ) -> tuple[Array, Array]:
        """Weighted residuals (C, rows, N), and their derivatives (C, rows, P, N) if asked for."""
        free = self.basis @ unknowns
        slack = np.where(np.arange(lobes.n_parameters) < 2 * lobes.count, OVERSHOOT, CENTER_OVERSHOOT)
        low, high = unknowns.min(axis=1, keepdims=True) - slack, unknowns.max(axis=1, keepdims=True) + slack
        parameters = np.clip(free, low, high)
        log_kappa, log_gamma, center = lobes.split(parameters)
        gamma = np.exp(log_gamma)[..., None]
        offset = self.theta_half - center[..., None]
        ring_log_cos = np.log(np.maximum(np.cos(offset), 1e-9))
        n = lobes.centered
        log_power = np.concatenate([gamma[:, :, :n] * self.log_cos, gamma[:, :, n:] * ring_log_cos], axis=2)
        exponent = np.exp(np.minimum(log_kappa[..., None] + log_power, np.log(_LARGEST_EXPONENT)))
        value = np.expm1(exponent)
        root = self.root[channels]
        residual = root * value.sum(axis=2) - self.data[channels]
        if not derivatives:
            return residual, np.empty(0)
        jacobian = np.empty((*residual.shape[:2], lobes.n_parameters, residual.shape[2]))
        by_log_kappa, by_log_gamma, by_center = (jacobian[:, :, part] for part in _slices(lobes))
        np.multiply(exponent, value + 1.0, out=by_log_kappa)
        by_log_kappa *= root[:, :, None]
        np.multiply(by_log_kappa, log_power, out=by_log_gamma)
        tangent = np.tan(np.clip(offset, -1.5, 1.5))
        np.multiply(by_log_kappa[:, :, n:], gamma[:, :, n:] * tangent, out=by_center)
        kept = free == parameters
        if not kept.all():
            jacobian *= kept[..., None]
        return residual, jacobian


@dataclass(frozen=True, eq=False)
class Refined:
    """Outcome of `minimize`.

    Attributes
    ----------
    unknowns : ndarray, shape (3, D, P)
    iterations : ndarray of int, shape (3,)
        Steps tried for each channel.
    converged : ndarray of bool, shape (3,)
        Whether the steps had become unimportant, rather than the bound on their number reached.
    """

    unknowns: Array
    iterations: NDArray[np.int64]
    converged: NDArray[np.bool_]


def minimize(
    problem: ProfileProblem,
    lobes: Lobes,
    start: Array,
    *,
    tolerance: float,
    iterations: int,
    on_iteration: Callable[[int], None] | None = None,
) -> Refined:
    """Least-squares fit of all channels by bounded Levenberg-Marquardt.

    Parameters
    ----------
    problem : ProfileProblem
    lobes : Lobes
    start : ndarray, shape (3, D, P)
        Unknowns to start from.
    tolerance : float
        A channel has converged when two steps in a row lower its squared error, floor included, by less than this
        share, or when no step does.
    iterations : int
        Bound on the steps.
    on_iteration : callable, optional
        Called with the number of each iteration.

    Returns
    -------
    Refined
    """
    low, high = lobes.bounds(problem.largest_kappa)
    unknowns = np.clip(start, low, high)
    anchor = unknowns.mean(axis=0)
    channels = len(unknowns)
    cost, normal, gradient = problem.linearize(lobes, unknowns, anchor, np.arange(channels))
    damping, growth = np.full(channels, 1e-3), np.full(channels, 2.0)
    small, used, active = np.zeros(channels, int), np.zeros(channels, np.int64), np.arange(channels)
    for iteration in range(1, iterations + 1):
        old, floor = unknowns[active], problem.floor[active]
        least, most = low[active], high[active]
        step = _step(old, least, most, normal[active], gradient[active], damping[active], problem.signal[active])
        new = np.clip(old + np.clip(step, -_LARGEST_STEP, _LARGEST_STEP), least, most)
        new_cost, new_normal, new_gradient = problem.linearize(lobes, new, anchor, active)
        gain = cost[active] - new_cost
        promised = np.maximum(
            _predicted_gain(new - old, normal[active], gradient[active]), 1e-150 * cost[active] + 1e-300
        )
        ratio = np.clip(gain / promised, -0.5, 1.5)
        better = gain > 0
        used[active] = iteration
        share = gain < tolerance * (cost[active] + floor)
        small[active] = np.where(better, np.where(share, small[active] + 1, 0), small[active])
        shrink = np.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        damping[active] = np.where(
            better, np.maximum(damping[active] * shrink, 1e-12), damping[active] * growth[active]
        )
        growth[active] = np.where(better, 2.0, 2.0 * growth[active])
        taken = active[better]
        unknowns[taken], cost[taken] = new[better], new_cost[better]
        normal[taken], gradient[taken] = new_normal[better], new_gradient[better]
        active = active[(small[active] < 2) & (damping[active] < _LARGEST_DAMPING)]
        if on_iteration is not None:
            on_iteration(iteration)
        if active.size == 0:
            break
    converged = np.ones(channels, bool)
    converged[active] = False
    return Refined(unknowns, used, converged)


def _step(
    unknowns: Array, low: Array, high: Array, normal: Array, gradient: Array, damping: Array, signal: Array
) -> Array:
    """Damped step (C, D, P) over the unknowns that are not held at a bound."""
    slope = gradient.reshape(unknowns.shape)
    held = ((unknowns <= low) & (slope > 0)) | ((unknowns >= high) & (slope < 0))
    free = ~held.reshape(gradient.shape)
    diagonal = np.einsum("cii->ci", normal)
    added = damping[:, None] * np.maximum(diagonal, 1e-10 * signal[:, None]) + 1e-15 * signal[:, None]
    matrix = np.where(free[:, :, None] & free[:, None, :], normal, 0.0)
    each = np.arange(gradient.shape[1])
    matrix[:, each, each] = np.where(free, diagonal + added, 1.0)
    solution = np.linalg.solve(matrix, np.where(free, -gradient, 0.0)[..., None])[..., 0]
    return np.asarray(solution.reshape(unknowns.shape))


def _predicted_gain(step: Array, normal: Array, gradient: Array) -> Array:
    """What the quadratic model of the cost promised for a step."""
    flat = step.reshape(gradient.shape)
    curvature = np.einsum("ci,ci->c", flat, (normal @ flat[..., None])[..., 0])
    return -(2.0 * np.einsum("ci,ci->c", flat, gradient) + curvature)


def _largest_kappa(peak: Array, knots: NDArray[np.intp]) -> Array:
    """Kappa whose lobe peaks at `_PEAK_ROOM` times the largest value of the rows around each knot, shape (3, D)."""
    first = np.concatenate([[0], knots[:-1]])
    last = np.concatenate([knots[1:], [peak.shape[1] - 1]])
    around = np.stack([peak[:, a : b + 1].max(axis=1) for a, b in zip(first, last, strict=True)], axis=1)
    # Where there are no data around a knot those of the whole channel must do.
    around = np.where(around > 0, around, peak.max(axis=1, keepdims=True))
    return np.clip(np.log1p(_PEAK_ROOM * around), 10.0 * KAPPA_BOUNDS[0], KAPPA_BOUNDS[1])


def _slices(lobes: Lobes) -> tuple[slice, slice, slice]:
    n = lobes.count
    return slice(0, n), slice(n, 2 * n), slice(2 * n, lobes.n_parameters)


def _all(unknowns: Array, channels: NDArray[np.intp] | None) -> NDArray[np.intp]:
    return np.arange(len(unknowns)) if channels is None else channels
