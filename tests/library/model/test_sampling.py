import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.sampling import LEAST_COSINE_SHARE
from tests.support.known_models import MODELS, single_lobe
from tests.support.random_models import random_model

Array = NDArray[np.float64]

N_SAMPLES = 30_000
PAIRS = [(name, angle) for name in MODELS for angle in (0.0, 21.0, 45.0, 69.9, 84.0, 88.9)]


def direction(theta_deg: float, phi_deg: float = 0.0) -> Array:
    theta, phi = np.radians([theta_deg, phi_deg])
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def copies(omega: Array, number: int = N_SAMPLES) -> Array:
    return np.broadcast_to(omega, (number, 3))


def half_angles(omega_in: Array, omega_out: Array) -> tuple[Array, Array]:
    half = omega_in + omega_out
    azimuth = np.mod(np.arctan2(half[:, 1], half[:, 0]), 2 * np.pi)
    return np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2]), azimuth


def expected_shares(model: DSBRDF, omega_out: Array, theta_edges: Array, phi_edges: Array) -> Array:
    """Integral of the density over bins of the half vector, by the midpoint rule on many cells a bin.

    At grazing angles the horizon, where the density ends, crosses many bins.
    """
    cells = 16 if omega_out[2] > 0.1 else 40

    def middles(edges: Array, count: int) -> tuple[Array, Array]:
        width = np.diff(edges)[:, None] / count
        return edges[:-1, None] + width * (np.arange(count) + 0.5), np.broadcast_to(width, (edges.size - 1, count))

    theta, theta_width = middles(theta_edges, cells)
    phi, phi_width = middles(phi_edges, cells)
    theta, phi = (part.ravel() for part in np.broadcast_arrays(theta[:, None, :, None], phi[None, :, None, :]))
    half = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    cosine = half @ omega_out
    omega_in = 2.0 * cosine[:, None] * half - omega_out
    omega_in /= np.linalg.norm(omega_in, axis=1)[:, None]
    density = np.where(cosine > 0.0, model.pdf(omega_in, omega_out) * 4.0 * cosine, 0.0) * np.sin(theta)
    density = density.reshape(theta_edges.size - 1, phi_edges.size - 1, cells, cells)
    return np.einsum("tpij,ti,pj->tp", density, theta_width, phi_width, optimize=True)


@pytest.mark.parametrize(("name", "angle"), PAIRS)
def test_samples_have_the_density_that_pdf_gives(name: str, angle: float) -> None:
    """Chi-square test at 1 %, corrected for the number of pairs; samples below the horizon are a bin of their own."""
    model, omega_out = MODELS[name], direction(angle, phi_deg=0.0)
    theta_edges = np.concatenate([[0.0], np.geomspace(2e-3, np.pi / 2, 14)])
    phi_edges = np.linspace(0.0, 2.0 * np.pi, 9)
    drawn = model.sample(copies(omega_out), np.random.default_rng(3))
    above = drawn.pdf > 0.0
    theta, phi = half_angles(drawn.omega_in[above], omega_out)
    counts, _, _ = np.histogram2d(theta, phi, (theta_edges, phi_edges))
    expected = expected_shares(model, omega_out, theta_edges, phi_edges) * N_SAMPLES
    observed = np.append(counts.ravel(), N_SAMPLES - above.sum())
    expected = np.append(expected.ravel(), N_SAMPLES - expected.sum())
    rare = expected < 10.0
    observed = np.append(observed[~rare], observed[rare].sum())
    expected = np.append(expected[~rare], max(float(expected[rare].sum()), 1.0))
    statistic = float(np.sum((observed - expected) ** 2 / expected))
    p_value = float(stats.chi2.sf(statistic, observed.size - 1))
    assert p_value > 1.0 - (1.0 - 0.01) ** (1.0 / len(PAIRS))


@pytest.mark.parametrize(("name", "angle"), PAIRS)
def test_mean_weight_is_the_albedo(name: str, angle: float) -> None:
    model = MODELS[name]
    weight = model.sample(copies(direction(angle, 130.0)), np.random.default_rng(5)).weight
    error = weight.std(axis=0) / np.sqrt(N_SAMPLES)
    albedo = model.albedo(np.radians(angle))
    assert np.all(np.abs(weight.mean(axis=0) - albedo) < 5.0 * error + 1e-3 * albedo)


@pytest.mark.parametrize("name", MODELS)
def test_weight_is_bounded_by_the_share_of_the_cosine(name: str) -> None:
    model = MODELS[name]
    for angle in (10.0, 60.0, 80.0):
        omega_out = copies(direction(angle))
        drawn = model.sample(omega_out, np.random.default_rng(11))
        bound = np.pi * model.evaluate_directions(drawn.omega_in, omega_out) / LEAST_COSINE_SHARE
        assert np.all(drawn.weight <= bound * (1.0 + 1e-9))


@pytest.mark.parametrize(
    ("name", "angles", "share"), [("mixture", (0.0, 45.0), 0.02), *((name, (75.0, 85.0, 89.0), 0.4) for name in MODELS)]
)
def test_variance_is_below_that_of_cosine_sampling(name: str, angles: tuple[float, ...], share: float) -> None:
    model, random = MODELS[name], np.random.default_rng(2)
    for angle in angles:
        omega_out = copies(direction(angle))
        radius, turn = np.sqrt(random.random(N_SAMPLES)), 2.0 * np.pi * random.random(N_SAMPLES)
        omega_in = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - radius**2)], axis=-1)
        by_cosine = np.pi * model.evaluate_directions(omega_in, omega_out).mean(axis=1)
        assert model.sample(omega_out, random).weight.mean(axis=1).var() < share * by_cosine.var()


@pytest.mark.parametrize(("elongation", "disc", "angle"), [(1.0, 0.0, 69.9), (0.0, 2e3, 45.0)])
def test_many_samples_have_the_stretch_and_the_disc_of_the_density(
    elongation: float, disc: float, angle: float
) -> None:
    model, omega_out = single_lobe(2.0, 50.0, 5.0, elongation=elongation, delta=disc), direction(angle)
    theta_edges = np.radians([0.0, 0.7, 0.95, 1.0, 1.05, 2.0, 5.0, 8.0, 12.0])
    phi_edges, number = np.linspace(0.0, 2.0 * np.pi, 17), 400_000
    drawn = model.sample(copies(omega_out, number), np.random.default_rng(3))
    theta, phi = half_angles(drawn.omega_in[drawn.pdf > 0.0], omega_out)
    counts, _, _ = np.histogram2d(theta, phi, (theta_edges, phi_edges))
    expected = number * expected_shares(model, omega_out, theta_edges, phi_edges)
    seen = expected >= 10.0
    statistic = float(np.sum((counts - expected)[seen] ** 2 / expected[seen]))
    assert stats.chi2.sf(statistic, np.count_nonzero(seen)) > 1e-3


def test_shapes_and_seeds() -> None:
    model = MODELS["mixture"]
    omega_out = np.broadcast_to(direction(30.0), (4, 5, 3))
    first = model.sample(omega_out, np.random.default_rng(8))
    again = model.sample(omega_out, np.random.default_rng(8))
    assert first.omega_in.shape == (4, 5, 3)
    assert first.pdf.shape == (4, 5)
    assert first.weight.shape == (4, 5, 3)
    assert np.array_equal(first.omega_in, again.omega_in)
    assert model.pdf(first.omega_in, direction(30.0)) == pytest.approx(first.pdf, rel=1e-9)
    assert model.sample(direction(30.0), np.random.default_rng(8)).pdf.shape == ()


def test_density_is_zero_below_the_horizon_where_nothing_is_drawn() -> None:
    model, up = MODELS["mixture"], direction(40.0)
    assert model.pdf(up * [1.0, 1.0, -1.0], up) == model.pdf(up, up * [1.0, 1.0, -1.0]) == 0.0
    with pytest.raises(InvalidArgumentError, match="omega_out must lie on or above the horizon"):
        model.sample(-up, np.random.default_rng(0))


def test_a_model_without_lobes_is_sampled_by_the_cosine() -> None:
    drawn = random_model(0, n_lobes=0).sample(copies(direction(50.0)), np.random.default_rng(0))
    assert np.all(drawn.weight == 0.0)
    assert np.all(np.isfinite(drawn.pdf))
