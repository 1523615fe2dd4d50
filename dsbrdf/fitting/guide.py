"""The guide: the few lobes of a material that a person can read.

An accurate mixture has lobes that lean on each other; which ones it has changes when the data hardly do. The guide has
one or two specular lobes and one diffuse lobe, all about the normal, coloured and elongated, with the tails of
Student's t over slopes, ``(1 + gamma tan(theta')**2)**-kappa``: kappa = 2 is the GGX distribution (Walter et al. 2007).

What the data leave open is decided by what materials are like, as a weak `Prior`:

- a highlight is neutral, as that of a clear coat is: its log amplitudes differ little between the channels;
- a highlight has the tails of GGX;
- a diffuse part is round, about as wide as a Lambertian surface seen through a coat, and falls evenly.

Without the last two, the tails of a rough highlight on a dark ground and the ground itself cannot be told apart.

A second specular lobe is kept only where it pays, is much wider than the first and has light of its own.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from dsbrdf.arrays import Array
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF
from dsbrdf.fitting.least_squares import FitData, MixtureProblem, Prior, minimize
from dsbrdf.fitting.structure import Mixture, ShapeBounds, Structure
from dsbrdf.fitting.weighting import center_share, interval_ends, seen_weight, trust
from dsbrdf.model.lobes import half_width, lobe_values, reach_of_width
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.model.splines import smooth_control_values

FAMILY = "student"
_KNOTS = np.radians([0.0, 40.0, 65.0, 80.0, 89.0]), np.radians([0.0, 60.0, 89.0]), np.radians([0.0, 89.0])
SPIKE_HALF_WIDTH = float(np.radians(3.0))
"""Border between the specular spike and the specular lobe [rad of theta_half]."""


_ANY, _SPIKE, _LOBE, _DIFFUSE = (
    ShapeBounds((lowest_kappa, 10.0), tuple(reach_of_width(np.radians(half_widths), FAMILY).tolist()))
    for lowest_kappa, half_widths in ((0.6, (0.15, 25.0)), (0.6, (0.15, 3.0)), (0.6, (3.0, 15.0)), (0.05, (30.0, 89.0)))
)
_NEUTRAL, _TAIL, _DIFFUSE_TAIL, _DIFFUSE_WIDTH, _ROUND = 1e-4, 2e-4, 1e-3, 1e-4, 1e-3
"""Pulls of the prior, as shares of the squared signal for each squared deviation of a control value."""
_GGX_KAPPA, _USUAL_DIFFUSE_KAPPA = 2.0, 1.1
_USUAL_REACH = float(np.log(reach_of_width(np.radians(70.0), FAMILY)))
_STARTS = ((0.6, 65.0), (2.0, 65.0), (8.0, 65.0))  # half widths [degrees]
_START_OF_TWO = (1.0, 6.0, 65.0)
_START_ELONGATION = 0.5
_FAINTEST_START = 0.02
_TOLERANCE, _ITERATIONS = 1e-3, 60
_PAYS = 0.7  # of the error with one specular lobe
_APART = 3.0  # how many times as wide as the first lobe the second is
_LEAST_LIGHT = 0.05  # of the specular light that each of two specular lobes holds
TYPICAL_ANGLES = np.radians(np.arange(0.0, 61.0, 15.0))
"""Angles theta_diff over which the median half width of a lobe is taken [rad]."""

_ROWS = np.radians([0.0, 10, 20, 30, 40, 48, 55, 61, 66, 70, 73, 76, 79, 82, 85, 88])
_COLUMNS = np.radians(np.concatenate([[0.0], np.geomspace(0.1, 2.0, 9), np.linspace(1.73, 9.27, 29) ** 2]))
_AZIMUTHS = np.radians(np.arange(9.0, 90.0, 18.0))


@dataclass(frozen=True, eq=False)
class Guide:
    """Readable lobes as a mixture: the specular ones from narrow to wide, then the diffuse one."""

    mixture: Mixture
    error: float  # root of the weighted squared error, as a share of the signal

    @property
    def half_widths(self) -> Array:
        """Half width of each lobe [rad], shape (K,): the median over theta_diff from 0 to 60 degrees."""
        _, shape, _ = _at(TYPICAL_ANGLES, self.mixture)
        kappa, gamma = np.split(np.exp(shape), 2, axis=1)
        return np.asarray(np.median(half_width(kappa, gamma, FAMILY), axis=0))

    @property
    def light(self) -> Array:
        """What each lobe reflects at theta_diff = 0, channels added, shape (K,) [1]."""
        amplitude, shape, _ = _at(np.zeros(1), self.mixture)
        kappa, gamma = np.split(np.exp(shape[0])[:, np.newaxis], 2)
        curves = lobe_values(np.tan(_COLUMNS) ** 2, kappa, gamma, None, FAMILY)
        measure = np.sin(2.0 * _COLUMNS) * np.gradient(_COLUMNS)
        return np.asarray(amplitude[:, 0].sum(axis=0) * (curves @ measure))


def fit_guide(data: FitData) -> Guide:
    """Fit the readable lobes to data with light: some value is not 0."""
    one = fit_single_highlight(data)
    two = _fit(data, guide_structure(_SPIKE, _LOBE), _START_OF_TWO)
    narrow, wide, _ = two.half_widths
    light = two.light[:2]
    differ = wide > _APART * narrow and light.min() > _LEAST_LIGHT * light.sum()
    return two if differ and two.error < _PAYS * one.error else one


def fit_single_highlight(data: FitData) -> Guide:
    """Fit a guide with one specular lobe to data as for `fit_guide`."""
    return min((_fit(data, guide_structure(), start) for start in _STARTS), key=lambda guide: guide.error)


def guide_data(model: ReflectanceModel) -> FitData:
    """Values of a model, with weights as those of "balanced": the error that a lit sphere shows, and the plain one."""
    theta_half, theta_diff, phi_diff = np.broadcast_arrays(
        _COLUMNS[:, np.newaxis], _ROWS[:, np.newaxis, np.newaxis], _AZIMUTHS
    )
    values = model.evaluate_unmasked(theta_half.ravel(), theta_diff.ravel(), phi_diff.ravel())
    mean = np.moveaxis(values.reshape(*theta_half.shape, 3), -1, 0)
    level = np.cos(theta_diff) * np.cos(theta_half)
    swing = np.sin(theta_diff) * np.sin(theta_half) * np.cos(phi_diff)
    lowest = np.maximum(level - swing, 0.0)
    trusted = trust(lowest, DEFAULT_HORIZON_CUTOFF) * np.diff(interval_ends(_ROWS))[:, np.newaxis, np.newaxis]
    solid_angle = -np.diff(np.cos(interval_ends(_COLUMNS)))[:, np.newaxis] * (np.sin(2.0 * theta_diff) + 0.1)
    lit = trusted * lowest * (level + swing) * solid_angle
    over_phi = (np.sum(lit * mean, axis=3) / np.maximum(lit.sum(axis=2), 1e-300))[..., np.newaxis]
    typical = np.sum(lit * mean) / (3.0 * lit.sum())
    seen = seen_weight(lit, over_phi, typical)
    center = center_share(_COLUMNS) * np.gradient(np.sqrt(_COLUMNS))
    plain = np.broadcast_to(trusted * center[:, np.newaxis], mean.shape)
    weight = np.add(*(1.0 / (np.sum(part * mean**2) or 1.0) * part for part in (seen, plain)))
    return FitData(mean, weight, np.cos(phi_diff) ** 2, _ROWS, _COLUMNS)


def guide_structure(*specular: ShapeBounds) -> Structure:
    """Structure of specular lobes within bounds, by default of a single one, and the diffuse lobe."""
    bounds = (*(specular or (_ANY,)), _DIFFUSE)
    return Structure((False,) * len(bounds), _KNOTS, FAMILY, np.zeros(1), bounds)


def _fit(data: FitData, structure: Structure, widths: tuple[float, ...]) -> Guide:
    """Fit the lobes of a structure from half widths [degrees]."""
    problem = MixtureProblem(data, structure, prior=_prior(structure))
    solution = minimize(problem, _start(problem, widths), tolerance=_TOLERANCE, iterations=_ITERATIONS)
    return Guide(Mixture(structure, solution.unknowns), float(np.sqrt(solution.cost / data.signal)))


def _prior(structure: Structure) -> Prior:
    """What materials are like, see the top of this file."""
    pull, target = np.zeros(structure.n_unknowns), np.zeros(structure.n_unknowns)
    k = structure.n_lobes
    usual = (float(np.log(_GGX_KAPPA)), float(np.log(_USUAL_DIFFUSE_KAPPA)), _USUAL_REACH, 0.0)
    for unknowns, values in ((pull, (_TAIL, _DIFFUSE_TAIL, _DIFFUSE_WIDTH, _ROUND)), (target, usual)):
        _, shape, elongation = structure.split(unknowns)
        shape[:, : k - 1], shape[:, k - 1], shape[:, -1], elongation[:, -1] = values
    matrix = np.diag(pull)
    channels = structure.split(np.arange(float(structure.n_unknowns)))[0].astype(np.intp).reshape(-1, 3, k)
    differ = _NEUTRAL * (np.eye(3) - 1.0 / 3.0)
    for row in channels[:, :, : k - 1].transpose(0, 2, 1).reshape(-1, 3):
        matrix[np.ix_(row, row)] += differ
    return Prior(matrix, target)


def _start(problem: MixtureProblem, widths: tuple[float, ...]) -> Array:
    """Unknowns of lobes with these half widths [degrees], and the amplitudes that fit each row best."""
    structure, data = problem.structure, problem.data
    k, n_rows = structure.n_lobes, data.theta_diff.size
    unknowns = np.zeros(structure.n_unknowns)
    amplitude, shape, elongation = structure.split(unknowns)
    shape[:, :k], shape[:, k - 1] = np.log(_GGX_KAPPA), np.log(_USUAL_DIFFUSE_KAPPA)
    shape[:, k:] = np.log(reach_of_width(np.radians(widths), FAMILY))
    elongation[:, : k - 1] = _START_ELONGATION
    curves = problem.curves(unknowns).reshape(k, n_rows, -1)
    heights = np.zeros((n_rows, 3, k))
    for row, channel in np.ndindex(n_rows, 3):
        root = np.sqrt(data.weight[channel, row].ravel())
        heights[row, channel] = nnls(curves[:, row].T * root[:, np.newaxis], data.mean[channel, row].ravel() * root)[0]
    level = np.sqrt(np.mean(heights**2, axis=(0, 1)))
    logs = np.log(np.maximum(heights, _FAINTEST_START * level + 1e-9)).reshape(n_rows, -1)
    amplitude[...] = smooth_control_values(problem.bases[0], logs)
    return unknowns


def _at(theta_diff: Array, mixture: Mixture) -> tuple[Array, Array, Array]:
    """Amplitude, log kappa and log gamma, and elongation at angles (R,)."""
    return mixture.structure.row_parameters(mixture.structure.bases(theta_diff), mixture.unknowns)
