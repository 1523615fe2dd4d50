"""Algorithm 1 of Nishino 2009 written out plainly: the reference of the batch fit, in results and in time.

One slice of one channel at a time, on the raw samples: the E-step in NumPy, the M-step one
``scipy.optimize.least_squares(method="lm")`` call for each lobe.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, least_squares

from dsbrdf.arrays import Array
from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement

TOLERANCE = 1e-14


@dataclass(frozen=True)
class RawSlice:
    """The samples of one channel at one theta_diff: their theta_half [rad] and values [1/sr], both of shape (N,)."""

    theta_half: Array
    value: Array


def raw_slice(
    measurement: Measurement, channel: int, row: int, *, horizon_cutoff: float | None, mask: float = 1.0
) -> RawSlice:
    """Valid samples within the cutoff and the perimeter mask, those with theta_half < 1 degree left out."""
    half, phi = np.meshgrid(THETA_HALF, PHI_DIFF, indexing="ij")
    diff = THETA_DIFF[row]
    swing = np.sin(half) * np.sin(diff) * np.cos(phi)
    lowest = np.cos(half) * np.cos(diff) - np.abs(swing)
    kept = measurement.valid[:, row, :] & (half >= np.radians(1.0)) & (half <= np.pi / 2 - mask * diff + 1e-9)
    if horizon_cutoff is not None:
        kept &= lowest >= np.cos(horizon_cutoff) - 1e-12
    return RawSlice(half[kept], measurement.values[channel, :, row, :][kept])


def plain_lobe(theta_half: Array, kappa: float | Array, gamma: float | Array) -> Array:
    """The unnormalised lobe; the arguments broadcast."""
    return np.expm1(kappa * np.cos(theta_half) ** gamma)


def initial_parameters(samples: RawSlice, n_lobes: int) -> Array:
    """Log kappa and log gamma, shape (n_lobes, 2): kappa from the peak, gamma from the half width, then halves."""
    nodes = np.unique(samples.theta_half)
    means = np.array([samples.value[samples.theta_half == node].mean() for node in nodes])
    peak = means.max()
    kappa = np.log1p(peak)
    last = np.flatnonzero(means >= peak / 2)[-1]
    angle = nodes[min(last + 1, len(nodes) - 1)]

    def above_half(log_gamma: float) -> float:
        return float(plain_lobe(angle, kappa, np.exp(log_gamma)) - peak / 2)

    gamma = np.exp(brentq(above_half, -20.0, 30.0, xtol=1e-14, rtol=1e-14))
    return np.log([[kappa / 2**k, gamma / 2**k] for k in range(n_lobes)])


def algorithm_1(samples: RawSlice, n_lobes: int, iterations: int) -> Array:
    """Kappa and gamma, shape (n_lobes, 2), after exactly so many iterations, sorted by kappa."""
    parameters = initial_parameters(samples, n_lobes)
    for _ in range(iterations):
        lobes = np.array([plain_lobe(samples.theta_half, *np.exp(p)) for p in parameters])
        responsibilities = lobes / lobes.sum(axis=0)
        parameters = np.array(
            [
                least_squares(
                    _residual,
                    start,
                    method="lm",
                    args=(samples.theta_half, share * samples.value),
                    xtol=TOLERANCE,
                    ftol=TOLERANCE,
                    gtol=TOLERANCE,
                ).x
                for start, share in zip(parameters, responsibilities, strict=True)
            ]
        )
    found = np.exp(parameters)
    return np.asarray(found[np.argsort(-found[:, 0])])


def _residual(parameters: Array, theta_half: Array, target: Array) -> Array:
    kappa, gamma = np.exp(parameters)
    return plain_lobe(theta_half, kappa, gamma) - target
