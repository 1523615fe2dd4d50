"""Algorithm 1 of Nishino 2009 on a batch of slices: expectation-maximisation for mixtures of hemi-EPDs.

A slice is the profile of one channel at one theta_diff: the mean L_n over phi_diff at each theta_half. The E-step
computes the responsibility q_k of each lobe l_k for the data,

    q_k(theta) = l_k(theta) / sum_j l_j(theta),

and the M-step fits each lobe to its part q_k L of the data, separately and by Levenberg-Marquardt,

    argmin over (kappa, gamma)_k of  sum_n w_n (q_k(theta_n) L_n - l(theta_n; kappa, gamma))**2,

where l = exp(kappa cos(theta)**gamma) - 1 is the paper's lobe, the hemispherical exponential power distribution without
its normalisation (eqs. 3 and 5). With gamma = 0, the lobe is constant (Lambertian); with gamma -> infinity, it is a
mirror.

Because q_k depends on theta_half only, sums of squares over all samples and over their means differ by a constant, so
that fits of `Profiles` equal fits of all samples. All slices, channels and lobes are iterated together. Each
Levenberg-Marquardt step solves a 2 x 2 system in (log kappa, log gamma) for each lobe. The lobes of height 1 in
`dsbrdf.model.lobes` are not used, because they would need four more derivatives.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.arrays import Array, Mask
from dsbrdf.model.lobes import gamma_of_half_width

EM_KAPPA_BOUNDS = (1e-9, 40.0)
"""Bounds of kappa: values up to 1e8/sr need at most log(1 + 1e8) = 18.4; twice this number allows extrapolation."""
EM_GAMMA_BOUNDS = (1e-4, 1e7)
"""Bounds of gamma, from a nearly constant lobe to a lobe with a half width of 0.02 degrees."""
_LOWER_LOG_BOUNDS = np.log([EM_KAPPA_BOUNDS[0], EM_GAMMA_BOUNDS[0]])
_UPPER_LOG_BOUNDS = np.log([EM_KAPPA_BOUNDS[1], EM_GAMMA_BOUNDS[1]])

EM_TOLERANCE = 1e-4
"""A slice has converged if an iteration changes the mixture by a smaller fraction of the norm of the data."""
M_STEP_TOLERANCE = 1e-9
M_STEP_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class SliceFits:
    """Mixtures fitted to a batch of slices: parameters (slices, lobes), and the convergence (slices,)."""

    kappa: Array
    gamma: Array
    iterations: NDArray[np.int64]
    converged: Mask


def fit_slices(
    theta_half: Array,
    mean: Array,
    weight: Array,
    n_lobes: int,
    *,
    iterations: int = 100,
    robust: bool = False,
    largest_kappa: ArrayLike = np.inf,
    on_iteration: Callable[[int], None] | None = None,
) -> SliceFits:
    """Fit a mixture of ``n_lobes`` hemi-EPDs to each slice, at angles theta_half (N,) [rad].

    `mean` and `weight` (slices, N) are the data [1/sr] and their weights; data with the weight 0 are ignored, and every
    slice needs a positive weight. `iterations` is the maximum number of EM iterations. A `robust` fit reduces the
    weights of large residuals (Huber's weights, from the mixture before each M-step). `largest_kappa` (slices,) bounds
    the height of lobes at smaller angles than theta_half. `on_iteration` is called with the number of each iteration.
    """
    log_cos = np.log(np.cos(theta_half))
    upper = np.tile(_UPPER_LOG_BOUNDS, (len(mean), 1))
    upper[:, 0] = np.log(np.clip(largest_kappa, 2.0 * EM_KAPPA_BOUNDS[0], EM_KAPPA_BOUNDS[1]))
    parameters = np.minimum(initialize(theta_half, mean, weight, n_lobes), upper[:, None])
    used = np.zeros(len(mean), np.int64)
    converged = np.zeros(len(mean), bool)
    # A slice of zeros has converged when its lobes are at the lower bound of kappa, even if gamma still changes.
    still = EM_TOLERANCE * np.sqrt(np.sum(weight * mean**2, axis=1)) + EM_KAPPA_BOUNDS[0] * np.sqrt(weight.sum(axis=1))
    active = np.arange(len(mean))
    for iteration in range(1, iterations + 1):
        data, weights, old = mean[active], weight[active], parameters[active]
        curves = lobe_curves(log_cos, old)
        targets = e_step(curves) * data[:, None, :]
        if robust:
            weights = weights * huber_weights(data - curves.sum(1), weights)
        new = m_step(log_cos, targets, weights, old, upper[active])
        change = np.sqrt(np.sum(weights * (lobe_curves(log_cos, new) - curves).sum(1) ** 2, axis=1))
        parameters[active] = new
        used[active] = iteration
        done = change <= still[active]
        converged[active[done]] = True
        active = active[~done]
        if on_iteration is not None:
            on_iteration(iteration)
        if active.size == 0:
            break
    order = np.argsort(-parameters[:, :, 0], axis=1, kind="stable")
    kappa, gamma = np.moveaxis(np.exp(np.take_along_axis(parameters, order[:, :, None], axis=1)), -1, 0)
    return SliceFits(kappa, gamma, used, converged)


def initialize(theta_half: Array, mean: Array, weight: Array, n_lobes: int) -> Array:
    """Return start values (slices, lobes, 2) of log kappa and log gamma.

    The kappa of the first lobe comes from the peak of the data, and gamma from the angle at which the data fall to half
    of the peak. Each further lobe has half of the previous lobe's kappa and gamma.
    """
    data = np.where(weight > 0, mean, 0.0)
    peak = np.maximum(data.max(axis=1), np.expm1(EM_KAPPA_BOUNDS[0]))
    kappa = np.clip(np.log1p(peak), *EM_KAPPA_BOUNDS)
    above = (data >= 0.5 * peak[:, None]) & (weight > 0)
    last = np.where(above.any(axis=1), above.shape[1] - 1 - np.argmax(above[:, ::-1], axis=1), 0)
    width = theta_half[np.minimum(last + 1, theta_half.size - 1)]
    gamma = gamma_of_half_width(width, kappa, "hemi_epd")
    halving = 0.5 ** np.arange(n_lobes)
    start = np.log(np.stack([kappa, np.clip(gamma, *EM_GAMMA_BOUNDS)], axis=-1)[:, None, :] * halving[:, None])
    return np.clip(start, _LOWER_LOG_BOUNDS, _UPPER_LOG_BOUNDS)


def lobe_curves(log_cos: Array, parameters: Array) -> Array:
    """Evaluate lobes (..., N) with parameters (..., 2), log kappa and log gamma, at angles with log-cosines (N,)."""
    kappa, gamma = np.exp(parameters[..., 0, None]), np.exp(parameters[..., 1, None])
    return np.expm1(kappa * np.exp(gamma * log_cos))


def e_step(curves: Array) -> Array:
    """Compute responsibilities (slices, lobes, N), which sum to 1 over the lobes (Nishino 2009, Algorithm 1).

    If all lobes underflow to zero at an angle, all responsibilities are equal there.
    """
    total = curves.sum(axis=1, keepdims=True)
    return np.where(total > 0, curves / np.where(total > 0, total, 1.0), 1.0 / curves.shape[1])


def huber_weights(residual: Array, weight: Array) -> Array:
    """Return Huber's weights of residuals (slices, N), with a scale from the median of their absolute values."""
    size = np.abs(residual)
    scale = 1.345 * 1.4826 * np.nanmedian(np.where(weight > 0, size, np.nan), axis=1, keepdims=True)
    return np.where(size <= scale, 1.0, scale / np.where(size > 0, size, 1.0))


def m_step(log_cos: Array, targets: Array, weights: Array, start: Array, upper: Array) -> Array:
    """Fit each lobe separately to the product of its responsibility and the data, `targets` (slices, lobes, N).

    `start` and the result are log kappa and log gamma (slices, lobes, 2), with upper bounds `upper` (slices, 2). The
    angles of the data have log-cosines `log_cos` (N,), and the data have `weights` (slices, N).
    """
    slices, lobes, n = targets.shape
    upper = np.repeat(upper, lobes, axis=0)
    target = targets.reshape(-1, n)
    root = np.repeat(np.sqrt(weights), lobes, axis=0)
    parameters = start.reshape(-1, 2).copy()
    damping = np.full(len(parameters), 1e-3)
    active = np.arange(len(parameters))
    residual, jacobian = _residuals(log_cos, target, root, parameters)
    for _ in range(M_STEP_ITERATIONS):
        old = parameters[active]
        cost = np.einsum("pn,pn->p", residual, residual)
        at_bound = np.stack([old <= _LOWER_LOG_BOUNDS, old >= upper[active]])
        step = _damped_step(jacobian, residual, damping[active], at_bound)
        new = np.clip(old + np.clip(step, -2.0, 2.0), _LOWER_LOG_BOUNDS, upper[active])
        new_residual, new_jacobian = _residuals(log_cos, target[active], root[active], new)
        better = np.einsum("pn,pn->p", new_residual, new_residual) <= cost
        parameters[active[better]] = new[better]
        residual = np.where(better[:, None], new_residual, residual)
        jacobian = np.where(better[:, None, None], new_jacobian, jacobian)
        damping[active] = np.where(better, damping[active] * 0.1, damping[active] * 10.0)
        still = np.abs(new - old).max(axis=1) > M_STEP_TOLERANCE
        still &= damping[active] < 1e12
        active, residual, jacobian = active[still], residual[still], jacobian[still]
        if active.size == 0:
            break
    return parameters.reshape(slices, lobes, 2)


def _residuals(log_cos: Array, target: Array, root: Array, parameters: Array) -> tuple[Array, Array]:
    """Return weighted residuals (problems, N) and their derivatives (problems, 2, N) in log kappa and log gamma."""
    kappa, gamma = np.exp(parameters[:, :1]), np.exp(parameters[:, 1:])
    log_power = gamma * log_cos
    exponent = kappa * np.exp(log_power)
    value = np.expm1(exponent)
    by_log_kappa = root * exponent * (value + 1.0)
    return root * (value - target), np.stack([by_log_kappa, by_log_kappa * log_power], axis=1)


def _damped_step(jacobian: Array, residual: Array, damping: Array, at_bound: Mask) -> Array:
    """Return Levenberg-Marquardt steps (problems, 2), each from a 2 x 2 system in closed form.

    ``at_bound`` (2, problems, 2) marks parameters at their lower and at their upper bound. A parameter whose step would
    cross its bound is fixed, and the step of the other parameter is computed alone: if the joint step were clipped
    instead, the other parameter would converge slowly.
    """
    normal = jacobian @ np.swapaxes(jacobian, 1, 2)
    gradient = np.einsum("pin,pn->pi", jacobian, residual)
    held = (at_bound[0] & (gradient > 0)) | (at_bound[1] & (gradient < 0))
    gradient = np.where(held, 0.0, gradient)
    floor = np.finfo(float).tiny
    a = normal[:, 0, 0] * (1.0 + damping) + floor
    b = normal[:, 1, 1] * (1.0 + damping) + floor
    c = np.where(held.any(axis=1), 0.0, normal[:, 0, 1])
    determinant = np.maximum(a * b - c * c, floor)
    step_kappa = (c * gradient[:, 1] - b * gradient[:, 0]) / determinant
    step_gamma = (c * gradient[:, 0] - a * gradient[:, 1]) / determinant
    return np.stack([step_kappa, step_gamma], axis=-1)
