"""The first lobes of a mixture: one highlight and one diffuse lobe, about the normal, coloured and elongated.

They have the tails of Student's t over slopes, ``(1 + gamma tan(theta')**2)**-kappa``: kappa = 2 is the GGX
distribution (Walter et al. 2007). What the data leave open is decided by what materials are like, as a weak `Prior`:

- a highlight is neutral, as that of a clear coat is: its log amplitudes differ little between the channels;
- a highlight has the tails of GGX;
- a diffuse part is round, about as wide as a Lambertian surface seen through a coat, and falls evenly.

Without the last two, the tails of a rough highlight on a dark ground and the ground itself cannot be told apart.
"""

import numpy as np
from scipy.optimize import nnls

from dsbrdf.arrays import Array
from dsbrdf.fitting.least_squares import FitData, MixtureProblem, Prior, minimize
from dsbrdf.fitting.structure import Mixture, ShapeBounds, Structure
from dsbrdf.model.lobes import reach_of_width
from dsbrdf.model.splines import smooth_control_values

_FAMILY = "student"
_KNOTS = np.radians([0.0, 40.0, 65.0, 80.0, 89.0]), np.radians([0.0, 60.0, 89.0]), np.radians([0.0, 89.0])
_HIGHLIGHT, _DIFFUSE = (
    ShapeBounds((lowest_kappa, 10.0), tuple(reach_of_width(np.radians(half_widths), _FAMILY).tolist()))
    for lowest_kappa, half_widths in ((0.6, (0.15, 25.0)), (0.05, (30.0, 89.0)))
)
_NEUTRAL, _TAIL, _DIFFUSE_TAIL, _DIFFUSE_WIDTH, _ROUND = 1e-4, 2e-4, 1e-3, 1e-4, 1e-3
"""Pulls of the prior, as shares of the squared signal for each squared deviation of a control value."""
_GGX_KAPPA, _USUAL_DIFFUSE_KAPPA = 2.0, 1.1
_USUAL_REACH = float(np.log(reach_of_width(np.radians(70.0), _FAMILY)))
_STARTS = ((0.6, 65.0), (2.0, 65.0), (8.0, 65.0))  # half widths [degrees]
START_ELONGATION = 0.5
"""Of a lobe that is not round, at the start of a fit."""
FAINTEST_START = 0.02
"""Of a typical amplitude, the least at the start: the derivatives of a fainter lobe are too small to change it."""
_MOST_ITERATIONS = 60


def fit_first_lobes(data: FitData) -> Mixture:
    """Fit the highlight and the diffuse lobe, in this order, to data with light: some value is not 0."""
    return min((_fit(data, start) for start in _STARTS), key=lambda fitted: fitted[0])[1]


def first_structure() -> Structure:
    """Structure of the two lobes."""
    return Structure((False, False), _KNOTS, _FAMILY, np.zeros(1), (_HIGHLIGHT, _DIFFUSE))


def _fit(data: FitData, widths: tuple[float, ...]) -> tuple[float, Mixture]:
    """Cost and lobes, found from half widths [degrees]."""
    structure = first_structure()
    problem = MixtureProblem(data, structure, prior=_prior(structure))
    solution = minimize(problem, _start(problem, widths), iterations=_MOST_ITERATIONS)
    return solution.cost, Mixture(structure, solution.unknowns)


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
    shape[:, k:] = np.log(reach_of_width(np.radians(widths), _FAMILY))
    elongation[:, : k - 1] = START_ELONGATION
    curves = problem.curves(unknowns)
    heights = np.zeros((n_rows, 3, k))
    for row, channel in np.ndindex(n_rows, 3):
        root = np.sqrt(data.weight[channel, row].ravel())
        heights[row, channel] = nnls(curves[row].T * root[:, np.newaxis], data.mean[channel, row].ravel() * root)[0]
    level = np.sqrt(np.mean(heights**2, axis=(0, 1)))
    logs = np.log(np.maximum(heights, FAINTEST_START * level + 1e-9)).reshape(n_rows, -1)
    amplitude[...] = smooth_control_values(problem.bases[0], logs)
    return unknowns
