"""The baseline that the benchmarks compare with is as good as it can be."""

import numpy as np
import pytest

from benchmarks.paper import ggx
from benchmarks.paper.ggx import FINE_STRIDE, Nodes, Objective, fit_ggx, microfacet, samples
from benchmarks.paper.table_interpolation import relative_rms, used_nodes
from dsbrdf import Measurement
from dsbrdf.data import THETA_HALF, nodes_above_horizon, synthetic_measurement
from tests.support.materials import polished_metal

CUTOFF = float(np.radians(80.0))


@pytest.fixture(scope="module")
def metal() -> Measurement:
    return polished_metal()


@pytest.fixture
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some thousand samples: enough to recover what is exact."""
    monkeypatch.setattr(ggx, "COARSE_STRIDE", 1009)
    monkeypatch.setattr(ggx, "FINE_STRIDE", 307)


def test_microfacet_derivative_is_that_of_its_values() -> None:
    nodes = Nodes(*np.random.default_rng(0).uniform(0.1, 1.0, (4, 50)))
    step = 1e-5
    higher, lower = (microfacet(0.2 * np.exp(sign * step), nodes)[0] for sign in (1.0, -1.0))
    np.testing.assert_allclose(microfacet(0.2, nodes)[1], (higher - lower) / (2 * step), rtol=1e-7)


@pytest.mark.usefixtures("few_samples")
@pytest.mark.parametrize("objective", ["plain", "log"])
def test_one_lobe_is_recovered(metal: Measurement, objective: Objective) -> None:
    model = fit_ggx(metal, 1, objective, CUTOFF)
    assert model.alpha == pytest.approx([0.05], rel=1e-4)
    np.testing.assert_allclose(model.f0[:, 0], (0.95, 0.64, 0.54), rtol=1e-3)
    np.testing.assert_allclose(model.weight, 1.0, rtol=1e-3)
    assert model.diffuse == pytest.approx(0.0, abs=1e-3)
    assert relative_rms(metal, model.row) < 1e-4
    assert model.n_numbers == 10


@pytest.mark.usefixtures("few_samples")
def test_two_lobes_over_a_diffuse_base_are_recovered(metal: Measurement) -> None:
    rough = synthetic_measurement(roughness=0.4, diffuse=(0.0, 0.0, 0.0), specular=(0.04, 0.04, 0.04))
    base = np.array([0.3, 0.2, 0.1])
    values = 0.2 * metal.values + 0.7 * rough.values + base[:, None, None, None] / np.pi
    model = fit_ggx(Measurement.from_values(values, nodes_above_horizon()), 2, "plain", CUTOFF)
    order = np.argsort(model.alpha)
    np.testing.assert_allclose(model.alpha[order], (0.05, 0.4), rtol=1e-3)
    np.testing.assert_allclose(model.weight[:, order], [(0.2, 0.7)] * 3, rtol=1e-2)
    np.testing.assert_allclose(model.diffuse, base, rtol=1e-2)


def test_no_row_of_theta_half_is_left_out_of_the_fit(plastic: Measurement) -> None:
    nodes, values = samples(plastic, CUTOFF, FINE_STRIDE)
    assert values.shape == (3, nodes.half.size)
    for i in np.flatnonzero(THETA_HALF >= np.radians(1.0)).tolist():
        taken = np.count_nonzero(np.isclose(nodes.half, np.cos(THETA_HALF[i]), rtol=0, atol=1e-12))
        assert abs(taken - np.count_nonzero(used_nodes(plastic, i, CUTOFF)) / FINE_STRIDE) < 1.0
