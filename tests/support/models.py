"""Models to test with, their samples, and pairs of directions at which to compare what becomes of them."""

from dataclasses import fields, replace
from io import BytesIO
from unittest.mock import patch

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf import DSBRDF, FitOptions, ScatteredSamples, fit, profiles
from dsbrdf.arrays import Array
from dsbrdf.components import DiffuseLayer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer
from dsbrdf.data import CHANNELS, model_measurement, spherical
from dsbrdf.data.geometry import random_directions
from dsbrdf.model import MAX_CENTER, half_width, sampling
from dsbrdf.model.splines import n_control_values
from dsbrdf.samples.names import VECTORS

SLICES = np.radians([5.0, 20.0, 47.0, 80.0])


def random_model(seed: int = 0, n_lobes: int = 4, family: str = "hemi_epd") -> DSBRDF:
    """Lobes such as fits find: a spike, wide ones, a ring and a cusp, elongated, changing from knot to knot."""
    random = np.random.default_rng([seed, n_lobes])
    shape, center = (1, 6, n_lobes), np.zeros((1, 6, n_lobes))
    wide = np.geomspace(3e3, 1.0, n_lobes) if n_lobes else np.zeros(0)
    center[..., 1:2] = random.uniform(-0.05, 0.4, (1, 6, 1))[..., : max(n_lobes - 1, 0)]
    return DSBRDF(
        np.radians([0.0, 30.0, 60.0, 80.0]),
        amplitude=np.exp(random.uniform(-3.0, 4.0, (3, 6, n_lobes))),
        kappa=np.exp(random.uniform(-2.0, 1.5, shape)),
        gamma=wide * np.exp(random.uniform(-0.5, 0.5, shape)),
        center=center,
        elongation=random.uniform(-0.5, 1.2, (5, n_lobes)),
        elongation_theta_diff=np.radians([0.0, 50.0, 85.0]),
        lobe=family,
    )


def papers_model(n_lobes: int = 3, knots: ArrayLike = SLICES, seed: int = 0) -> DSBRDF:
    """The paper's lobes exp(kappa cos**gamma) - 1, a shape for each channel, and its delta term."""
    random = np.random.default_rng(seed)
    shape = (3, np.size(knots), n_lobes)
    kappa = random.uniform(0.1, 6.0, shape)
    gamma, delta = np.exp(random.uniform(-1.0, 9.0, shape)), random.uniform(0.0, 2.0, shape[:2])
    return DSBRDF(np.asarray(knots, float), np.expm1(kappa), kappa, gamma, delta=delta, interpolation="linear")


COARSE_ANGLES = sampling.ANGLES[::10]
"""Every 15th degree: densities tabulated there are near enough for tests, and found in a tenth of the time."""
NOISE = 0.02
"""Relative standard deviation of every sample."""
HALF_WIDTHS = np.radians([1.5, 8.0, 50.0])
"""Of the hemi-EPD lobes at normal incidence [rad]; a seed changes each by up to a fifth."""
HEIGHTS = np.array([30.0, 3.0, 0.3]) / np.pi
"""At normal incidence [1/sr]; a seed changes each by up to a factor of 2, and gives it a colour; no light is gained."""
KNOTS = np.radians([0.0, 45.0, 89.0])
CHECKED_ANGLES = np.radians([0.0, 30.0, 60.0, 75.0])
"""theta_diff at which parameters are compared [rad]."""


def mixture(n_lobes: int, seed: int) -> DSBRDF:
    """Material of 1 to 3 well separated lobes, coloured and elongated, that change smoothly with theta_diff."""
    random = np.random.default_rng([seed, n_lobes])
    chosen = np.sort(random.permutation(HALF_WIDTHS.size)[:n_lobes])
    share = np.linspace(0.0, 1.0, KNOTS.size + 2)[:, None]
    colour = 2.0 ** random.uniform(-0.7, 0.7, (3, 1, n_lobes))
    height = HEIGHTS[chosen] * 2.0 ** random.uniform(-1.0, 1.0, n_lobes) * colour
    height = height * np.exp(random.uniform(0.0, 1.4, n_lobes) * share**2)
    width = HALF_WIDTHS[chosen] * (1.0 + 0.2 * random.uniform(-1.0, 1.0, n_lobes))
    kappa = random.uniform(0.7, 3.0, n_lobes) * np.ones_like(share)
    gamma = np.log(np.log1p(np.expm1(kappa) / 2.0) / kappa) / np.log(np.cos(width))
    gamma = gamma * np.exp(random.uniform(-0.3, 0.3, n_lobes) * share)
    elongation = random.uniform(0.2, 1.0, (1, n_lobes))
    return DSBRDF(KNOTS, amplitude=height, kappa=kappa[None], gamma=gamma[None], elongation=elongation)


def scattered_samples(model: DSBRDF, count: int, seed: int = 1) -> ScatteredSamples:
    directions = scattered_directions(model, count, seed)
    return ScatteredSamples.from_arrays(*directions, model.evaluate_directions(*directions), name="known")


def in_plane(model: DSBRDF) -> ScatteredSamples:
    """Five angles of incidence, 40 of reflection, 2 % noise."""
    theta_in, theta_out = np.meshgrid(np.radians([0, 15, 30, 45, 60]), np.radians(np.linspace(-80, 80, 40)))
    pair = spherical(theta_in.ravel(), np.pi), spherical(theta_out.ravel(), 0.0)
    noise = 1.0 + 0.02 * np.random.default_rng(1).standard_normal((theta_in.size, 3))
    return ScatteredSamples.from_arrays(*pair, noise * model.evaluate_directions(*pair))


def samples_table(samples: ScatteredSamples) -> bytes:
    file, columns = BytesIO(), np.hstack([samples.omega_in, samples.omega_out, samples.values])
    np.savetxt(file, columns, "%.17g", ",", header=",".join((*VECTORS, *CHANNELS)), comments="")
    return file.getvalue()


def scattered_directions(model: DSBRDF, count: int, seed: int) -> tuple[Array, Array]:
    """Return pairs of directions, shapes (count, 3): half of them where a model reflects, half anywhere."""
    random = np.random.default_rng(seed)
    omega_in, omega_out = (random_directions(random, np.sqrt(random.uniform(0.02, 1.0, count))) for _ in ("in", "out"))
    with patch.object(sampling, "ANGLES", COARSE_ANGLES):
        where = replace(model).sample(omega_out[: count // 2], random)[0]
    above = np.flatnonzero(where[:, 2] > 0.05)
    omega_in[above] = where[above]
    return omega_in, omega_out


def found_by_fit(n_lobes: int, seed: int) -> DSBRDF:
    data = profiles(model_measurement(mixture(n_lobes, seed), noise=NOISE, seed=seed))
    return fit(data, FitOptions()).model


def numbers_of_lobes(model: DSBRDF) -> tuple[int, int]:
    rings = int(np.count_nonzero(model.is_ring))
    return model.n_lobes - rings, rings


def deviations(model: DSBRDF, truth: DSBRDF) -> dict[str, float]:
    """Largest relative deviations of a model's parameters, for as many lobes, at `CHECKED_ANGLES`.

    An elongation does nothing at theta_diff = 0 and is left out there.
    """
    parts = []
    for one in (model, truth):
        found = one.parameters_at(CHECKED_ANGLES)
        width = half_width(found["kappa"], found["gamma"], model.lobe)
        order = np.argsort(width[0, 0])
        own = {name: found[name][..., order] for name in ("amplitude", "kappa", "gamma")}
        parts.append(own | {"half width": width[..., order], "elongation": found["elongation"][1:, order]})
    return {name: float(np.max(np.abs(parts[0][name] / parts[1][name] - 1.0))) for name in parts[0]}


TEXTS = ("interpolation", "lobe")
ARRAYS = tuple(field.name for field in fields(DSBRDF) if field.name not in TEXTS)


def make_model(n_lobes: int = 3, n_knots: int = 5, interpolation: str = "spline") -> DSBRDF:
    """Parameters of every magnitude, with all 53 bits in use; one shape for each channel unless it is a spline."""
    random = np.random.default_rng(n_lobes)
    spline = interpolation == "spline"
    count = n_control_values if spline else int
    n_shape_knots, n_elongation_knots = n_knots + 1, 2
    shape = (1 if spline else 3, count(n_shape_knots), n_lobes)

    def knots(number: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return np.sort(random.uniform(0.0, np.pi / 2, number))

    return DSBRDF(
        theta_diff=knots(n_knots),
        amplitude=10.0 ** random.uniform(-300.0, 300.0, (3, count(n_knots), n_lobes)),
        kappa=10.0 ** random.uniform(-300.0, 2.8, shape),
        gamma=10.0 ** random.uniform(-320.0, 100.0, shape),
        center=random.uniform(-MAX_CENTER, MAX_CENTER, shape),
        elongation=random.uniform(-10.0, 10.0, (count(n_elongation_knots), n_lobes)),
        shape_theta_diff=knots(n_shape_knots),
        elongation_theta_diff=knots(n_elongation_knots),
        delta=10.0 ** random.uniform(-300.0, 300.0, (3, n_knots)),
        interpolation=interpolation,
        lobe="student" if spline else "hemi_epd",
    )


def assert_same_bits(got: DSBRDF, expected: DSBRDF) -> None:
    for name in ARRAYS:
        first, second = getattr(got, name), getattr(expected, name)
        assert first.shape == second.shape
        assert first.tobytes() == second.tobytes()
    for name in TEXTS:
        assert getattr(got, name) == getattr(expected, name)


MODELS = {
    "mixture": mixture(3, 0),
    "elongated rings and cusps": random_model(1),
    "student": random_model(2, family="student"),
    "paper": papers_model(),
}


def surface(f0: tuple[float, float, float], alpha: float, under_coat: float = 0.0) -> SpecularLayer:
    """Return a surface with the tails of GGX."""
    return SpecularLayer(f0, 0.9, alpha, 2.0, (0.0, 0.0), 0.5, under_coat)


COAT = SpecularLayer((0.04, 0.041, 0.042), 0.9, 0.05, 2.0, (0.2, -0.3), 0.4, 0.0)
METAL = SpecularLayer((0.9, 0.6, 0.3), 1.1, 0.3, 5.0, (-0.1, 0.2), 0.8, 1.0, 0.7, 0.6)
GROUND = DiffuseLayer((0.4, 0.2, 0.05), (0.7, 0.1, -0.2, 0.3, 0.5, -0.6))
SHEEN = SheenLayer((0.02, 0.03, 0.1), (2.0, 3.0))
RETRO = RetroLayer((0.1, 0.2, 0.3), 0.1)
LAYERS = LayeredModel((COAT, METAL, GROUND, SHEEN, RETRO))
"""A layer of each kind, one of them under a coat."""


def single_lobe(
    kappa: float,
    gamma: float,
    amplitude: float | None = None,
    *,
    center: float = 0.0,
    elongation: float = 0.0,
    delta: float = 0.0,
    family: str = "hemi_epd",
) -> DSBRDF:
    """Return a lobe that does not change with theta_diff; as high as the paper's if not told otherwise."""
    one = np.ones((1, 1, 1))
    height = np.full((3, 1, 1), np.expm1(kappa) if amplitude is None else amplitude)
    shape = kappa * one, gamma * one, center * one, np.full((1, 1), elongation)
    return DSBRDF(np.zeros(1), height, *shape, delta=np.full((3, 1), delta), interpolation="linear", lobe=family)


def plain_lobe(theta_half: Array, kappa: float | Array, gamma: float | Array) -> Array:
    """The paper's lobe, not divided by its height; the arguments broadcast."""
    return np.expm1(kappa * np.cos(theta_half) ** gamma)


def pairs_of_directions(number: int, *, lowest: float = 0.1, spread: float | None = 0.04) -> tuple[Array, Array]:
    """Return pairs in single precision above a smallest cosine; every second one near the mirror direction."""
    random = np.random.default_rng(0)
    first, second = random_directions(random, random.uniform(lowest, 1.0, (2, number)))
    if spread is not None:
        mirrored = first * [-1.0, -1.0, 1.0] + random.normal(0.0, spread, first.shape)
        mirrored[:, 2] = np.maximum(mirrored[:, 2], lowest)
        second[::2] = (mirrored / np.linalg.norm(mirrored, axis=1)[:, None])[::2]
    return first.astype(np.float32).astype(float), second.astype(np.float32).astype(float)
