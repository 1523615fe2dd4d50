"""What a user would fit instead: Lambert plus GGX microfacet lobes, by SciPy's least squares on the samples.

    f_c = diffuse_c / pi + sum_l weight_lc [f0_lc + (1 - f0_lc) (1 - cos theta_diff)^5] D_l V_l

with the GGX distribution D and the height-correlated Smith visibility V (Walter et al. 2007; Heitz 2014), Schlick's
Fresnel term, one roughness alpha for each lobe, and RGB weights and reflectances f0 (Schlick 1994). For given
roughnesses the model is linear in weight f0 and weight (1 - f0), both of which must not be negative: that gives the
starts, the best of all pairs on a grid of roughnesses by non-negative least squares, and with them a baseline that does
not fail for want of a good start. Every start is polished in all unknowns by `scipy.optimize.least_squares` with
analytic derivatives.

V depends on phi_diff, so the samples are fitted and not their means: every n-th node, staggered over the three axes so
that every row of each of them takes part.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares, nnls

from benchmarks.paper.table_interpolation import used_nodes
from dsbrdf import Measurement
from dsbrdf.arrays import Array
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF, incident_cosines
from dsbrdf.fitting import OUTSIDE_CENTER

__all__ = ["FINE_STRIDE", "GGXModel", "Nodes", "Objective", "fit_ggx", "microfacet", "samples"]

Objective = Literal["plain", "log"]

N_STARTS = 4
COARSE_STRIDE = 127
"""Every 127th node (about 6,000 of a measurement) decides between the starts; prime, so that no axis is aliased."""
FINE_STRIDE = 31
"""Every 31st node (about 25,000) for the final fit."""
ALPHA_BOUNDS = (0.002, 1.0)
_ALPHA_GRID = np.geomspace(0.004, 0.9, 26)
_RIDGE = 1e-12


@dataclass(frozen=True, eq=False)
class GGXModel:
    """Lambert plus L GGX lobes.

    `normal` and `grazing`, shape (3, L), are the factors of D V at normal and towards grazing incidence.
    """

    diffuse: Array
    alpha: Array
    normal: Array
    grazing: Array

    @property
    def weight(self) -> Array:
        """Weight of each lobe, shape (3, L)."""
        return self.normal + self.grazing

    @property
    def f0(self) -> Array:
        """Reflectance at normal incidence relative to the weight, shape (3, L); 0 where the weight is."""
        return self.normal / np.where(self.weight > 0, self.weight, 1.0)

    @property
    def n_numbers(self) -> int:
        """How many numbers describe the model."""
        return self.diffuse.size + self.alpha.size + self.normal.size + self.grazing.size

    def evaluate(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Values at N points, shape (N, 3) [1/sr]; angles in radians, both directions above the horizon."""
        cos_in, cos_out = incident_cosines(theta_half, theta_diff, phi_diff)
        # At the horizon itself masking is 0 / 0; a cosine as small as this is as good.
        cos_in, cos_out = np.maximum(cos_in, 1e-6), np.maximum(cos_out, 1e-6)
        nodes = Nodes(np.cos(theta_half), np.cos(theta_diff), cos_in, cos_out)
        lobes = np.array([microfacet(float(alpha), nodes)[0] for alpha in self.alpha])
        brightness = self.normal[..., None] + self.grazing[..., None] * nodes.schlick
        return np.asarray(self.diffuse / np.pi + np.einsum("cln,ln->nc", brightness, lobes))

    def row(self, i: int) -> Array:
        """Values on the theta_half row ``i`` of the grid, shape (3, 90, 180) [1/sr]; 0 below the horizon."""
        cos_in, cos_out = incident_cosines(THETA_HALF[i], THETA_DIFF[:, None], PHI_DIFF)
        above = (cos_in > 0) & (cos_out > 0)
        cos_diff = np.broadcast_to(np.cos(THETA_DIFF)[:, None], above.shape)[above]
        nodes = Nodes(np.full(cos_diff.shape, np.cos(THETA_HALF[i])), cos_diff, cos_in[above], cos_out[above])
        values = np.zeros((3, *above.shape))
        values[:, above] = self.diffuse[:, None] / np.pi
        for lobe, alpha in enumerate(self.alpha):
            brightness = self.normal[:, lobe, None] + self.grazing[:, lobe, None] * nodes.schlick
            values[:, above] += brightness * microfacet(float(alpha), nodes)[0]
        return values


@dataclass(frozen=True, eq=False)
class Nodes:
    """Cosines of samples, each of shape (N,)."""

    half: Array
    diff: Array
    incident: Array
    outgoing: Array

    @property
    def schlick(self) -> Array:
        """(1 - cos theta_diff)^5."""
        return np.asarray((1.0 - self.diff) ** 5)


def microfacet(alpha: float, nodes: Nodes) -> tuple[Array, Array]:
    """D V and its derivative with respect to log alpha, each of shape (N,)."""
    square = alpha * alpha
    slope = (1.0 - nodes.half) * (1.0 + nodes.half) + square * nodes.half**2
    root_in = np.sqrt(square + (1.0 - square) * nodes.incident**2)
    root_out = np.sqrt(square + (1.0 - square) * nodes.outgoing**2)
    masking = nodes.outgoing * root_in + nodes.incident * root_out
    value = square / (np.pi * slope**2) * 0.5 / masking
    masking_rate = square * (
        nodes.outgoing * (1.0 - nodes.incident**2) / root_in + nodes.incident * (1.0 - nodes.outgoing**2) / root_out
    )
    rate = 2.0 - 4.0 * square * nodes.half**2 / slope - masking_rate / masking
    return value, value * rate


def samples(measurement: Measurement, horizon_cutoff: float | None, stride: int) -> tuple[Nodes, Array]:
    """Every ``stride``-th of the nodes that the metrics use, and their values (3, N) [1/sr]."""
    angles, values, offset = [], [], 0
    for i in np.flatnonzero(OUTSIDE_CENTER).tolist():
        row, column = np.nonzero(used_nodes(measurement, i, horizon_cutoff))
        first = -offset % stride
        offset += row.size
        row, column = row[first::stride], column[first::stride]
        angles.append(np.stack([np.full(row.shape, THETA_HALF[i]), THETA_DIFF[row], PHI_DIFF[column]]))
        values.append(measurement.values_at(i)[:, row, column])
    theta_half, theta_diff, phi_diff = np.concatenate(angles, axis=1)
    cos_in, cos_out = incident_cosines(theta_half, theta_diff, phi_diff)
    return Nodes(np.cos(theta_half), np.cos(theta_diff), cos_in, cos_out), np.concatenate(values, axis=1)


def fit_ggx(
    measurement: Measurement, n_lobes: int, objective: Objective = "plain", horizon_cutoff: float | None = None
) -> GGXModel:
    """Fit Lambert plus one or two GGX lobes; return the best of `N_STARTS` starts.

    The objective is the squared error of f, or of log(1 + f cos_in).
    """
    coarse, values = samples(measurement, horizon_cutoff, COARSE_STRIDE)
    polished = [_polish(start, coarse, values, objective) for start in _starts(coarse, values, n_lobes, objective)]
    unknowns = min(polished, key=lambda result: result[0])[1]
    fine, values = samples(measurement, horizon_cutoff, FINE_STRIDE)
    return _unpack(_polish(unknowns, fine, values, objective)[1], n_lobes)


def _starts(nodes: Nodes, values: Array, n_lobes: int, objective: Objective) -> list[Array]:
    """Best combinations of roughnesses on a grid, with their factors; the log objective to first order."""
    lobes = np.array([microfacet(float(alpha), nodes)[0] for alpha in _ALPHA_GRID])
    columns = np.concatenate([np.full((1, values.shape[1]), 1.0 / np.pi), lobes, lobes * nodes.schlick])
    combinations = list(combinations_with_replacement(range(_ALPHA_GRID.size), n_lobes))
    errors = np.zeros(len(combinations))
    factors = np.zeros((len(combinations), 3, 1 + 2 * n_lobes))
    for channel, sample in enumerate(values):
        root = np.ones_like(sample) if objective == "plain" else nodes.incident / (1.0 + sample * nodes.incident)
        weighted, target = columns * root, sample * root
        gram, moment = weighted @ weighted.T, weighted @ target
        for number, combination in enumerate(combinations):
            chosen = np.array([0, *(1 + np.array(combination)), *(1 + _ALPHA_GRID.size + np.array(combination))])
            factors[number, channel], error = _nonnegative(gram[np.ix_(chosen, chosen)], moment[chosen])
            errors[number] += error
    picked: list[int] = []
    for number in np.argsort(errors).tolist():
        distances = [np.abs(np.subtract(combinations[number], combinations[other])).max() for other in picked]
        if len(picked) < N_STARTS and all(distance > 1 for distance in distances):
            picked.append(number)
    return [_pack(_ALPHA_GRID[list(combinations[number])], factors[number]) for number in picked]


def _nonnegative(gram: Array, moment: Array) -> tuple[Array, float]:
    """Minimise x G x - 2 m x over x >= 0 and return x and the minimum."""
    size = np.sqrt(np.diag(gram))
    scaled = gram / np.outer(size, size) + _RIDGE * np.eye(size.size)
    lower = np.linalg.cholesky(scaled)
    target = solve_triangular(lower, moment / size, lower=True)
    solution, residual = nnls(lower.T, target)
    return solution / size, float(residual**2 - target @ target)


def _polish(unknowns: Array, nodes: Nodes, values: Array, objective: Objective) -> tuple[float, Array]:
    """Least squares in all unknowns; returns the cost and the unknowns."""
    n_lobes = (unknowns.size - 3) // 7
    low = np.zeros_like(unknowns)
    high = np.full_like(unknowns, np.inf)
    low[:n_lobes], high[:n_lobes] = np.log(ALPHA_BOUNDS)
    residuals, jacobian = _problem(nodes, values, n_lobes, objective)
    # A factor at its bound gets a push inside, so that its derivative can tell whether it wants to grow.
    factors = unknowns[n_lobes:].reshape(3, -1)
    factors = np.maximum(factors, 1e-4 * factors.max(axis=1, keepdims=True) + 1e-9)
    start = np.concatenate([np.clip(unknowns[:n_lobes], low[:n_lobes] + 1e-6, high[:n_lobes] - 1e-6), factors.ravel()])
    result = least_squares(
        residuals, start, jacobian, bounds=(low, high), x_scale="jac", ftol=1e-6, xtol=1e-6, gtol=1e-10, max_nfev=60
    )
    return float(result.cost), np.asarray(result.x)


def _problem(
    nodes: Nodes, values: Array, n_lobes: int, objective: Objective
) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Residuals (3 N,) and their derivatives (3 N, 3 + 7 L) as functions of the unknowns."""
    target = values if objective == "plain" else np.log1p(values * nodes.incident)
    norm = 1.0 / np.sqrt(np.sum(target**2))
    schlick = nodes.schlick

    def basis_at(unknowns: Array) -> tuple[Array, Array, Array]:
        lobes, rates = np.array([microfacet(float(np.exp(x)), nodes) for x in unknowns[:n_lobes]]).transpose(1, 0, 2)
        basis = np.concatenate([np.full((1, schlick.size), 1.0 / np.pi), lobes, lobes * schlick])
        return basis, rates, unknowns[n_lobes:].reshape(3, -1)

    def residuals(unknowns: Array) -> Array:
        basis, _, factors = basis_at(unknowns)
        fit = factors @ basis
        return np.asarray(norm * ((fit if objective == "plain" else np.log1p(fit * nodes.incident)) - target)).ravel()

    def jacobian(unknowns: Array) -> Array:
        basis, rates, factors = basis_at(unknowns)
        outer = np.ones_like(values)
        if objective == "log":
            outer = nodes.incident / (1.0 + (factors @ basis) * nodes.incident)
        result = np.zeros((3, schlick.size, unknowns.size))
        for channel in range(3):
            first = n_lobes + channel * len(basis)
            result[channel, :, first : first + len(basis)] = (norm * outer[channel] * basis).T
            normal, grazing = factors[channel, 1 : 1 + n_lobes, None], factors[channel, 1 + n_lobes :, None]
            result[channel, :, :n_lobes] = (norm * outer[channel] * rates * (normal + grazing * schlick)).T
        return result.reshape(-1, unknowns.size)

    return residuals, jacobian


def _pack(alpha: Array, factors: Array) -> Array:
    return np.concatenate([np.log(alpha), factors.ravel()])


def _unpack(unknowns: Array, n_lobes: int) -> GGXModel:
    factors = unknowns[n_lobes:].reshape(3, -1)
    return GGXModel(factors[:, 0], np.exp(unknowns[:n_lobes]), factors[:, 1 : 1 + n_lobes], factors[:, 1 + n_lobes :])
