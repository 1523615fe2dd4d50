from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from dsbrdf import DSBRDF
from dsbrdf.arrays import Array
from dsbrdf.data import THETA_DIFF, THETA_HALF
from dsbrdf.fitting.fit_data import FitData
from dsbrdf.fitting.lobe_candidates import AMPLITUDE_PRIOR, Candidates, fit_amplitudes
from dsbrdf.fitting.lobe_search import MAX_SEARCHED_LOBES, SearchData, SearchStep, Wanted, search
from dsbrdf.fitting.mixture import Mixture, Structure
from dsbrdf.fitting.mixture_problem import MixtureProblem
from dsbrdf.model import FAMILIES, gamma_of_half_width

KNOTS = np.radians([0.0, 40.0, 70.0, 89.0])
ROWS = np.array([0, 12, 24, 36, 48, 60, 70, 76, 82])
HELD_OUT_ROWS = np.array([6, 18, 30, 42, 54, 65, 73, 79])
COLUMNS = np.unique(np.concatenate([[0, 3, 6], np.arange(9, 90, 4)]))
COS2_PHI = np.cos(np.radians([15.0, 45.0, 75.0])) ** 2


def lobes_of(*lobes: tuple[float, float, float], elongation: float = 0.6, family: str = "hemi_epd") -> DSBRDF:
    """Coloured lobes (height, half width, center) in 1/sr and degrees that grow towards grazing angles."""
    height, width, center = np.array(lobes).reshape(-1, 3).T
    growth = np.exp(1.5 * np.linspace(0.0, 1.0, 4))[:, None]
    colour = np.array([1.0, 0.6, 1.3])[:, None, None]
    kappa = np.ones((1, 1, width.size))
    gamma = gamma_of_half_width(np.radians(width), kappa, family)
    shape = kappa, gamma, np.radians(center) * kappa, np.full((1, width.size), elongation)
    return DSBRDF(np.radians([0.0, 89.0]), colour * growth * height, *shape, np.zeros(1), lobe=family)


def data_of(model: DSBRDF, rows: NDArray[np.intp] = ROWS, *, noise: float = 0.0, seed: int = 0) -> FitData:
    """Folded bins of the model, every one of the same weight."""
    shape = rows.size, COLUMNS.size, COS2_PHI.size
    half = np.broadcast_to(THETA_HALF[COLUMNS][:, None], shape)
    diff = np.broadcast_to(THETA_DIFF[rows][:, None, None], shape)
    phi = np.broadcast_to(np.arccos(np.sqrt(COS2_PHI)), shape)
    mean = model.evaluate_unmasked(half.ravel(), diff.ravel(), phi.ravel()).T.reshape(3, *shape)
    mean = mean * (1.0 + noise * np.random.default_rng(seed).standard_normal(mean.shape))
    weight = 1.0 / (mean + 0.05 * np.median(mean)) ** 1.2  # so that dark lobes count too, as in a fit
    return FitData(mean, weight, np.broadcast_to(COS2_PHI, shape), THETA_DIFF[rows], THETA_HALF[COLUMNS])


def searched(
    model: DSBRDF,
    n_lobes: int | Literal["auto"] = "auto",
    ring_lobes: int | Literal["auto"] = "auto",
    *,
    noise: float = 0.02,
    on_stage: Callable[[], None] = lambda: None,
) -> tuple[Mixture, list[SearchStep]]:
    structure = Structure((), (KNOTS, KNOTS[[0, 3]], KNOTS[:1]), model.lobe)
    fitted, held_out = data_of(model, noise=noise), data_of(model, HELD_OUT_ROWS, noise=noise)
    data = SearchData(fitted, held_out)
    return search(data, structure, Wanted(n_lobes, ring_lobes), lambda _: data, on_stage)


def share_left(mixture: Mixture, data: FitData) -> float:
    residual = MixtureProblem(data, mixture.structure).values(mixture.unknowns) - data.mean
    return float(np.sum(data.weight * residual**2)) / data.signal


TWO = lobes_of((40.0, 1.5, 0.0), (0.3, 50.0, 0.0))


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("width", [1.5, 45.0])
def test_one_lobe_is_found_where_it_is(width: float, family: str) -> None:
    model = lobes_of((3.0, width, 0.0), family=family)
    mixture, _ = searched(model, 1, 0, noise=0.0)
    assert mixture.structure.rings == (False,)
    assert share_left(mixture, data_of(model)) < 1e-3


@pytest.mark.parametrize("center", [8.0, 60.0])
def test_ring_is_found(center: float) -> None:
    model = lobes_of((0.3, 50.0, 0.0), (2.0, 5.0, center), elongation=0.0)
    mixture, _ = searched(model, 2, 1, noise=0.0)
    assert mixture.structure.rings == (False, True)
    assert share_left(mixture, data_of(model)) < 3e-3
    found = mixture.structure.split(mixture.unknowns)[1][:, -1]
    np.testing.assert_allclose(np.degrees(found), center, atol=2.0)


@pytest.mark.parametrize("center", [-9.0, 0.0, 40.0])
def test_first_candidate_is_of_the_kind_of_the_lobe(center: float) -> None:
    """A negative center makes a cusp, which is steeper at its top than any lobe about the normal."""
    data = data_of(lobes_of((5.0, 6.0, center), elongation=0.0))
    candidates, none = Candidates.at(data, "hemi_epd"), np.zeros((ROWS.size, 3, 0))
    every = np.ones(candidates.center.size, bool)
    chosen = candidates.best(np.zeros((ROWS.size, 3, 0, 0)), np.zeros((ROWS.size, 3, 0, every.size)), none, every)
    assert np.degrees(candidates.center[chosen]) == pytest.approx(center, abs=0.1)


@pytest.mark.parametrize(("n_lobes", "ring_lobes"), [(4, 0), (4, 3)])
def test_asked_for_numbers_are_given_rings_last(n_lobes: int, ring_lobes: int) -> None:
    mixture, _ = searched(TWO, n_lobes, ring_lobes)
    assert mixture.structure.rings == (False,) * (n_lobes - ring_lobes) + (True,) * ring_lobes
    low, high = mixture.structure.bounds
    assert np.all((low <= mixture.unknowns) & (mixture.unknowns <= high))


def test_one_number_can_be_fixed_and_the_other_found() -> None:
    assert searched(TWO, 3, "auto")[0].structure.n_lobes == 3
    assert searched(TWO, "auto", 1)[0].structure.n_rings == 1
    assert searched(lobes_of((3.0, 8.0, 0.0)))[0].structure.rings == (False,)
    for count, rings in ((7, 0), (8, "auto")):  # Any ring would explain data at so few theta_half.
        few = replace(data_of(TWO), theta_half=THETA_HALF[COLUMNS[:count]])
        assert Wanted("auto", "auto").limited_to(few).ring_lobes == rings


def test_few_lobes_do_not_stay_where_one_start_ends() -> None:
    """Two lobes for four: the first choice ends at an error of 0.009."""
    model = lobes_of((20.0, 2.0, 0.0), (2.0, 10.0, 0.0), (0.5, 25.0, 0.0), (0.2, 60.0, 0.0))
    assert share_left(searched(model, 2)[0], data_of(model)) < 0.007


def test_amplitudes_are_fitted_first_as_well_as_scipy_fits_them() -> None:
    """All shapes stay, and the error falls from many times the signal to less than the signal."""
    data, structure = data_of(TWO), Structure((False, False), (KNOTS, KNOTS[[0, 3]], KNOTS[:1]), TWO.lobe)
    start = np.zeros(structure.n_unknowns)
    amplitude, shape, _ = structure.split(start)
    amplitude += 2.0
    shape[:, 2:] = [-4.0, -0.5]
    changed = structure.parts[0]

    def mixture(log_amplitudes: Array) -> Mixture:
        return Mixture(structure, np.concatenate([log_amplitudes, start[changed.stop :]]))

    def cost(log_amplitudes: Array) -> float:
        change = log_amplitudes - start[changed]
        return share_left(mixture(log_amplitudes), data) + AMPLITUDE_PRIOR * float(change @ change)

    found = fit_amplitudes(data, Mixture(structure, start)).unknowns
    np.testing.assert_array_equal(found[changed.stop :], start[changed.stop :])
    assert cost(found[changed]) == pytest.approx(minimize(cost, found[changed], method="L-BFGS-B").fun, rel=2e-3)
    assert share_left(mixture(start[changed]), data) > 10.0
    assert share_left(mixture(found[changed]), data) < 1.0


def test_search_says_what_it_tried() -> None:
    """Where the residual of many lobes is noise, as few as leave no more are enough."""
    calls: list[int] = []
    model = lobes_of((40.0, 1.5, 0.0), (2.0, 12.0, 0.0), (0.3, 50.0, 0.0))
    mixture, steps = searched(model, on_stage=lambda: calls.append(1))
    assert len(calls) == len(steps)
    tried = [(step.n_lobes, step.kept) for step in steps]
    assert tried == [(MAX_SEARCHED_LOBES, True), (1, False), (2, False), (3, True)]
    assert steps[3].error < 0.1 * steps[2].error < 0.1 * steps[1].error < 0.1
    assert steps[3].error == pytest.approx(share_left(mixture, data_of(model, HELD_OUT_ROWS, noise=0.02)), rel=1e-9)


def test_lobes_that_miss_the_shape_of_a_material_are_all_kept() -> None:
    """A tiny change of the data would decide on a removal, if the lobes of a material with ripples could go."""
    ripple = 1.0 + 0.3 * np.sin(25.0 * THETA_HALF[COLUMNS])[:, None]
    parts = (data_of(TWO, rows) for rows in (ROWS, HELD_OUT_ROWS))
    data = SearchData(*(replace(part, mean=part.mean * ripple) for part in parts))
    empty = Structure((), (KNOTS, KNOTS[[0, 3]], KNOTS[:1]), TWO.lobe)
    mixture, steps = search(data, empty, Wanted("auto", "auto"), lambda _: data, lambda: None)
    assert [(step.n_lobes, step.kept) for step in steps] == [(MAX_SEARCHED_LOBES, True)]
    assert steps[0].error == pytest.approx(share_left(mixture, data.held_out), rel=1e-6)
