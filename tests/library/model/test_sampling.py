import copy

import numpy as np
import pytest
from scipy.special import chdtrc

from dsbrdf import DSBRDF, InvalidArgumentError
from dsbrdf.arrays import Array
from dsbrdf.data import spherical
from dsbrdf.model.sampling import MIN_COSINE_FRACTION
from tests.support import models
from tests.support.models import random_model, single_lobe

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse_sampling")]
MODELS = {name: copy.copy(model) for name, model in models.MODELS.items()}
"""Copies, whose tables of densities are theirs alone."""
N_SAMPLES = 30_000
PAIRS = [(name, angle) for name in MODELS for angle in (0.0, 45.0, 69.9, 88.9)]


def direction(theta_deg: float, phi_deg: float = 0.0) -> Array:
    return spherical(*np.radians([theta_deg, phi_deg]))


def copies(omega: Array, number: int = N_SAMPLES) -> Array:
    return np.broadcast_to(omega, (number, 3))


def p_value(model: DSBRDF, angle: float, theta_edges: Array, sectors: int, number: int) -> float:
    """Of the chi-square test that samples have the density of `pdf`, in bins of the half vector.

    What is beyond the bins, or below the horizon, is a bin of its own, and so are all rare ones.
    """
    omega_out, phi_edges = direction(angle), np.linspace(0.0, 2.0 * np.pi, sectors + 1)
    drawn = model.sample(copies(omega_out, number), np.random.default_rng(3))
    half = (drawn.omega_in + omega_out)[drawn.pdf > 0.0]
    theta, phi = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2]), np.arctan2(half[:, 1], half[:, 0])
    counts, _, _ = np.histogram2d(theta, np.mod(phi, 2.0 * np.pi), (theta_edges, phi_edges))

    cells = 16 if angle < 84.0 else 40  # midpoints a bin: at grazing angles the density ends within many of them
    edges = theta_edges, phi_edges
    fine = [np.interp(np.arange((e.size - 1) * cells + 1) / cells, np.arange(e.size), e) for e in edges]
    theta, phi = np.meshgrid(*(0.5 * (edges[1:] + edges[:-1]) for edges in fine), indexing="ij")
    half = spherical(theta, phi)
    cosine = half @ omega_out
    omega_in = 2.0 * cosine[..., None] * half - omega_out
    omega_in /= np.linalg.norm(omega_in, axis=-1, keepdims=True)
    density = np.where(cosine > 0.0, model.pdf(omega_in, omega_out) * 4.0 * cosine, 0.0) * np.sin(theta)
    shares = density * np.diff(fine[0])[:, None] * np.diff(fine[1])
    expected = number * shares.reshape(theta_edges.size - 1, cells, sectors, cells).sum(axis=(1, 3)).ravel()
    observed, expected = np.append(counts, number - counts.sum()), np.append(expected, number - expected.sum())
    rare = expected < 10.0
    observed = np.append(observed[~rare], observed[rare].sum())
    expected = np.append(expected[~rare], max(float(expected[rare].sum()), 1.0))
    return float(chdtrc(observed.size - 1, np.sum((observed - expected) ** 2 / expected)))


@pytest.mark.parametrize(("name", "angle"), PAIRS)
def test_samples_have_the_density_that_pdf_gives_and_the_albedo_as_mean_weight(name: str, angle: float) -> None:
    model = MODELS[name]
    found = p_value(model, angle, np.append(0.0, np.geomspace(2e-3, np.pi / 2, 14)), 8, N_SAMPLES)
    assert found > 1.0 - (1.0 - 0.01) ** (1.0 / len(PAIRS))  # 1 %, corrected for the number of pairs
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
        bound = np.pi * model.evaluate_directions(drawn.omega_in, omega_out) / MIN_COSINE_FRACTION
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
def test_many_samples_have_the_stretch_and_disc_of_the_density(elongation: float, disc: float, angle: float) -> None:
    model = single_lobe(2.0, 50.0, 5.0, elongation=elongation, delta=disc)
    theta_edges = np.radians([0.0, 0.7, 0.95, 1.0, 1.05, 2.0, 5.0, 8.0, 12.0])
    assert p_value(model, angle, theta_edges, 16, 400_000) > 1e-3


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
    with pytest.raises(
        InvalidArgumentError, match=r"omega_out must lie on or above the horizon \(z >= 0\); its smallest z is -0\.766"
    ):
        model.sample(-up, np.random.default_rng(0))


def test_a_model_without_lobes_is_sampled_by_the_cosine() -> None:
    drawn = random_model(0, n_lobes=0).sample(copies(direction(50.0)), np.random.default_rng(0))
    assert np.all(drawn.weight == 0.0)
    assert np.all(np.isfinite(drawn.pdf))
