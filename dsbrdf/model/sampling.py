"""Directions drawn in proportion to what a model reflects, roughly, and the density that they have exactly.

A direction omega_in is drawn from a mixture of the model's lobes, of the disc theta_half < 1 degree (the paper's delta
term) and of the cosine of the normal, which suits broad lobes and bounds the weights f cos(theta_in) / pdf.  For each
theta_out the shares begin as the parts of the directional albedo that the densities can stand for, and are then
improved until the variance of the weights,

    integral (f cos(theta_in))**2 / pdf d omega_in,

changes little: w_m <- w_m sqrt(integral (f cos)**2 p_m / pdf**2), whose fixed point is the least one (the function is
convex in the shares).  No share of the cosine is below `LEAST_COSINE_SHARE`.

A lobe is drawn as a half vector h, with the shape that it has at theta_diff = theta_out, where its center is:

1. theta' by inversion.  For the hemi-EPD about the normal the exponential series is itself a mixture (Nishino 2009,
   eq. 3, expanded): the density of u = cos(theta') is proportional to

       exp(kappa u**gamma) - 1 = sum_{n >= 1} kappa**n / n! u**(n gamma),

   so n is drawn by its share kappa**n / (n! (n gamma + 1)) of the energy, and u = v**(1 / (n gamma + 1)) with v uniform
   is exact.  Any other lobe (ring, cusp, Student's t) is drawn from its values in `_N_CELLS` cells of theta'.
2. The azimuth is uniform, and the slopes (x, y) = tan(theta') (cos, sin) are stretched along and across the plane of
   incidence by c**(e/2) and c**(-e/2), the inverse of the stretch in `dsbrdf.model.lobes`.  Their product is 1, so the
   density per solid angle only changes by cos(theta')**3 / cos(theta_half)**3.
3. omega_in is omega_out mirrored at h, which divides the density by 4 h . omega_out.

Everything that depends on theta_out is tabulated at `ANGLES`; a direction takes the nearest one, in `sample` and in
`pdf` alike, so that both agree to rounding.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import CENTER_CUTOFF
from dsbrdf.model.albedo import half_vector_rule
from dsbrdf.model.hemi_epd import energy
from dsbrdf.model.lobes import half_width, lobe_values, log_cosine

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Evaluate = Callable[[Array, Array, Array], Array]

__all__ = ["ANGLES", "LEAST_COSINE_SHARE", "DirectionSampler", "LobesAtAngles", "Samples", "direction_sampler"]

ANGLES = np.radians(np.arange(0.0, 90.5, 1.5))
"""Angles theta_out to the normal at which the mixture is tabulated [rad]."""
LEAST_COSINE_SHARE = 0.1
"""Share of the cosine at every angle, so that no weight exceeds ``pi f / LEAST_COSINE_SHARE``."""
_ALBEDO_STEPS, _VARIANCE_STEPS = 5, 15
_LAST_ANGLE = np.radians(89.5)  # the shares at 90 degrees are those of this angle: there nothing is above the horizon
_N_CELLS = 192
_LEAST_DENSITY = 1e-3  # of a cell, as a share of the mean one: no direction is left out


class Samples(NamedTuple):
    """Directions drawn for `dsbrdf.DSBRDF.sample`.

    Attributes
    ----------
    omega_in : ndarray, shape (..., 3)
        Unit vectors; a few may be below the horizon (z < 0), with pdf and weight 0.
    pdf : ndarray, shape (...)
        Density per solid angle [1/sr].
    weight : ndarray, shape (..., 3)
        ``f cos(theta_in) / pdf``, whose mean is the directional albedo.
    """

    omega_in: Array
    pdf: Array
    weight: Array


@dataclass(frozen=True, eq=False)
class LobesAtAngles:
    """M lobes of one colour channel or all, at the N angles of `ANGLES`; each array has shape (N, M).

    Attributes
    ----------
    kappa, gamma, center, elongation : ndarray
    family : str
        One of `dsbrdf.model.lobes.FAMILIES`.
    """

    kappa: Array
    gamma: Array
    center: Array
    elongation: Array
    family: str


@dataclass(frozen=True, eq=False)
class DirectionSampler:
    """The mixture of densities at all angles; made by `direction_sampler`.

    Attributes
    ----------
    lobes : LobesAtAngles
    log_ratio : ndarray, shape (N, M)
        ``elongation log c``, the logarithm of the stretch.
    cumulative : ndarray, shape (N, M + 2)
        Running sum of the shares of the lobes, of the disc theta_half < 1 degree and of the cosine.
    is_series : ndarray of bool, shape (M,)
        Lobes about the normal, drawn by their series.
    terms : ndarray, shape (N, M, T)
        Running sum of the shares of the terms n = 1..T.
    energy : ndarray, shape (N, M)
        Integral of ``expm1(kappa cos**gamma)`` over the hemisphere [sr].
    edges, cells : ndarray, shape (N, M, 193)
        Edges of the cells in theta' [rad], and running sum of the cells' shares.
    """

    lobes: LobesAtAngles
    log_ratio: Array
    cumulative: Array
    is_series: NDArray[np.bool_]
    terms: Array
    energy: Array
    edges: Array
    cells: Array

    def sample(self, omega_out: Array, rng: np.random.Generator) -> Array:
        """Draw a direction omega_in for each omega_out, both of shape (n, 3)."""
        row = _row(omega_out)
        chosen = _find(self.cumulative, row, rng.random(row.size))
        n_lobes = self.log_ratio.shape[1]
        cosine = chosen > n_lobes
        omega_in = np.empty_like(omega_out)
        omega_in[cosine] = _cosine_directions(rng.random((2, int(cosine.sum()))))
        row, chosen, omega_out = row[~cosine], chosen[~cosine], omega_out[~cosine]
        tangent = self._draw_tangent(row, chosen, rng.random((2, row.size)))
        angle = 2.0 * np.pi * rng.random(row.size)
        half_log = 0.5 * np.where(chosen < n_lobes, self.log_ratio[row, np.minimum(chosen, n_lobes - 1)], 0.0)
        along = tangent * np.cos(angle) * np.exp(half_log)
        across = tangent * np.sin(angle) * np.exp(-half_log)
        x, y = _heading(omega_out)
        half = np.stack([along * x - across * y, along * y + across * x, np.ones_like(along)], axis=-1)
        half /= np.sqrt(np.einsum("ni,ni->n", half, half))[:, None]
        omega_in[~cosine] = 2.0 * np.einsum("ni,ni->n", half, omega_out)[:, None] * half - omega_out
        return omega_in

    def pdf(self, omega_in: Array, omega_out: Array) -> Array:
        """Density per solid angle of omega_in for omega_out, both of shape (n, 3); 0 below the horizon."""
        result = np.zeros(len(omega_in))
        above = np.flatnonzero((omega_in[:, 2] > 0.0) & (omega_out[:, 2] > 0.0))
        first, second = omega_in[above], omega_out[above]
        row = _row(second)
        share = np.diff(self.cumulative, axis=1, prepend=0.0)[row]
        result[above] = np.einsum("nm,mn->n", share, self.densities(row, first, second))
        return result

    def densities(self, row: Indices, omega_in: Array, omega_out: Array) -> Array:
        """Densities of omega_in (n, 3) of each part of the mixture, shape (M + 2, n), as tabulated in a row (n,)."""
        total = omega_in + omega_out
        length = np.sqrt(np.einsum("ni,ni->n", total, total))
        x, y = _heading(omega_out)
        along = ((total[:, 0] * x + total[:, 1] * y) / total[:, 2]) ** 2
        across = ((total[:, 1] * x - total[:, 0] * y) / total[:, 2]) ** 2
        cos_half = total[:, 2] / length
        result = np.empty((self.log_ratio.shape[1] + 2, len(total)))
        for lobe in range(self.log_ratio.shape[1]):
            ratio = np.exp(self.log_ratio[row, lobe])
            squared = along / ratio + across * ratio
            result[lobe] = self._density(row, lobe, squared) * ((1.0 + squared) * cos_half**2) ** -1.5
        edge = np.cos(CENTER_CUTOFF)
        result[-2] = (cos_half > edge) / (2.0 * np.pi * (1.0 - edge))
        result[:-1] /= 2.0 * length  # h . omega_out is half the length
        result[-1] = omega_in[:, 2] / np.pi
        return result

    def _draw_tangent(self, row: Indices, chosen: Indices, uniform: Array) -> Array:
        """tan(theta') of lobes, or of the disc theta_half < 1 degree where none is chosen, shape (n,)."""
        n_lobes = self.log_ratio.shape[1]
        first, second = uniform
        cos = 1.0 - first * (1.0 - np.cos(CENTER_CUTOFF))
        tangent = np.sqrt(1.0 - cos * cos) / cos
        for lobe in range(n_lobes):
            mine = np.flatnonzero(chosen == lobe)
            at = row[mine]
            if self.is_series[lobe]:
                n = 1.0 + _find(self.terms[:, lobe], at, first[mine])
                log_cos = np.log1p(-second[mine]) / (n * self.lobes.gamma[at, lobe] + 1.0)
                tangent[mine] = np.sqrt(np.expm1(np.minimum(-2.0 * log_cos, 60.0)))
            else:
                cell = _find(self.cells[:, lobe, 1:], at, first[mine])
                low, high = (np.sin(0.5 * self.edges[at, lobe, cell + i]) ** 2 for i in (0, 1))
                tangent[mine] = np.tan(2.0 * np.arcsin(np.sqrt(low + second[mine] * (high - low))))
        return tangent

    def _density(self, row: Indices, lobe: int, squared: Array) -> Array:
        """Density of theta' per solid angle, from tan(theta')**2 (n,)."""
        lobes = self.lobes
        if self.is_series[lobe]:
            kappa, gamma = lobes.kappa[row, lobe], lobes.gamma[row, lobe]
            return lobe_values(squared, kappa, gamma, None, "hemi_epd") * np.expm1(kappa) / self.energy[row, lobe]
        edges, cells = self.edges[:, lobe], self.cells[:, lobe]
        cell = _find(edges[:, 1:] / np.pi, row, np.arctan(np.sqrt(squared)) / np.pi)
        low, high = (np.sin(0.5 * edges[row, cell + i]) ** 2 for i in (0, 1))
        return (cells[row, cell + 1] - cells[row, cell]) / (4.0 * np.pi * (high - low))


def direction_sampler(lobes: LobesAtAngles, evaluate: Evaluate) -> DirectionSampler:
    """Tabulate the mixture for a model.

    Parameters
    ----------
    lobes : LobesAtAngles
    evaluate : callable
        ``evaluate(theta_half, theta_diff, phi_diff) -> (n, 3)`` [1/sr] for angles (n,).

    Returns
    -------
    DirectionSampler
    """
    is_series = ~np.any(lobes.center != 0.0, axis=0) & (lobes.family == "hemi_epd")
    log_ratio = lobes.elongation * log_cosine(ANGLES)[:, None]
    whole = energy(lobes.kappa, lobes.gamma) if is_series.any() else np.ones_like(lobes.kappa)
    terms = _series_shares(lobes.kappa, lobes.gamma) if is_series.any() else np.ones((*lobes.kappa.shape, 1))
    edges, cells = _cells(lobes)
    cumulative = np.empty((ANGLES.size, log_ratio.shape[1] + 2))
    sampler = DirectionSampler(lobes, log_ratio, cumulative, is_series, terms, whole, edges, cells)
    for row, theta_out in enumerate(ANGLES):
        running = np.cumsum(_shares(sampler, row, float(theta_out), evaluate))
        cumulative[row] = running / running[-1]
    return replace(sampler, cumulative=cumulative)


def _shares(sampler: DirectionSampler, row: int, theta_out: float, evaluate: Evaluate) -> Array:
    """Shares of the parts of the mixture at one angle, shape (M + 2,)."""
    theta_out = min(theta_out, _LAST_ANGLE)
    rule = half_vector_rule(theta_out)
    used = rule.cos_in > 0.0
    theta_half, azimuth, cos_in = rule.theta_half[used], rule.azimuth[used], rule.cos_in[used]
    sin_half = np.sin(theta_half)
    half = np.stack([sin_half * np.cos(azimuth), sin_half * np.sin(azimuth), np.cos(theta_half)], axis=-1)
    omega_out = np.broadcast_to(np.array([np.sin(theta_out), 0.0, np.cos(theta_out)]), half.shape)
    omega_in = 2.0 * np.einsum("ni,ni->n", half, omega_out)[:, None] * half - omega_out
    densities = sampler.densities(np.full(cos_in.size, row), omega_in, omega_out)
    reflected = evaluate(theta_half, rule.theta_diff[used], rule.phi_diff[used]).mean(axis=1) * cos_in
    first = reflected * rule.weight[used] / cos_in
    share = np.full(len(densities), 1.0 / len(densities))
    for step in range(_ALBEDO_STEPS + _VARIANCE_STEPS):
        inverse = 1.0 / (share @ densities)
        if step < _ALBEDO_STEPS:
            share = share * (densities @ (first * inverse))
        else:
            share = share * np.sqrt(densities @ (first * reflected * inverse**2))
        share /= max(share.sum(), 1e-300)
        share[:-1] *= min(1.0, (1.0 - LEAST_COSINE_SHARE) / max(share[:-1].sum(), 1e-300))
        share[-1] = 1.0 - share[:-1].sum()
    return share


def _series_shares(kappa: Array, gamma: Array) -> Array:
    """Running sum of the shares of kappa**n / (n! (n gamma + 1)), n = 1..T, along a new last axis."""
    largest = float(kappa.max())
    n = np.arange(1.0, largest + 12.0 * np.sqrt(largest) + 30.0)
    log_term = n * np.log(kappa[..., None]) - np.cumsum(np.log(n)) - np.log(n * gamma[..., None] + 1.0)
    term = np.exp(log_term - log_term.max(axis=-1, keepdims=True))
    running = np.cumsum(term, axis=-1)
    return running / running[..., -1:]


def _cells(lobes: LobesAtAngles) -> tuple[Array, Array]:
    """Edges in theta' [rad] and running sum of the cells' shares of the energy, shapes (N, M, `_N_CELLS` + 1).

    Half of the edges are spaced evenly in the logarithm, half about the center by the half width.
    """
    width = half_width(lobes.kappa, lobes.gamma, lobes.family)[..., None]
    count = _N_CELLS // 2
    even = np.geomspace(1e-5, np.pi / 2, count) * np.ones_like(width)
    steps = np.sinh(np.linspace(-3.0, 3.0, _N_CELLS - count)) * 0.4
    near = np.maximum(lobes.center, 0.0)[..., None] + width * steps
    edges = np.sort(np.concatenate([np.zeros_like(width), even, np.clip(near, 0.0, np.pi / 2)], axis=-1), axis=-1)
    solid_angle = np.diff(np.sin(0.5 * edges) ** 2, axis=-1)
    middle = np.tan(0.5 * (edges[..., 1:] + edges[..., :-1])) ** 2
    shape = (lobes.kappa[..., None], lobes.gamma[..., None], lobes.center[..., None])
    share = lobe_values(middle, *shape, lobes.family) * solid_angle
    share /= share.sum(axis=-1, keepdims=True)
    share = share + _LEAST_DENSITY * solid_angle / solid_angle.sum(axis=-1, keepdims=True)
    running = np.concatenate([np.zeros_like(width), np.cumsum(share, axis=-1)], axis=-1)
    return edges, running / running[..., -1:]


def _row(omega_out: Array) -> Indices:
    """Index in `ANGLES` of the angle nearest to each direction."""
    theta = np.arctan2(np.hypot(omega_out[:, 0], omega_out[:, 1]), omega_out[:, 2])
    return np.clip(np.rint(theta / ANGLES[1]), 0, ANGLES.size - 1).astype(np.intp)


def _heading(omega: Array) -> tuple[Array, Array]:
    """Cosine and sine of the azimuth, 1 and 0 along the normal."""
    radius = np.hypot(omega[:, 0], omega[:, 1])
    safe = np.where(radius > 0.0, radius, 1.0)
    return np.where(radius > 0.0, omega[:, 0] / safe, 1.0), omega[:, 1] / safe


def _find(running: Array, row: Indices, value: Array) -> Indices:
    """First index in its row of (N, T) whose running sum, at most 1, is above each value of (n,), 0 to 1.

    One search for all rows: row r is moved to r..r + 1.
    """
    n_rows, width = running.shape
    flat = (np.arange(n_rows)[:, None] * 2.0 + running).ravel()
    place = np.searchsorted(flat, row * 2.0 + value, side="right") - row * width
    return np.minimum(place, width - 1)


def _cosine_directions(uniform: Array) -> Array:
    """Directions (n, 3) with density cos(theta) / pi from numbers (2, n) between 0 and 1."""
    radius, angle = np.sqrt(uniform[0]), 2.0 * np.pi * uniform[1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - uniform[0])], axis=-1)
