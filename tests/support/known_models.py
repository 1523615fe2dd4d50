"""One model of each kind, and pairs of directions at which to compare what becomes of them."""

import numpy as np

from dsbrdf import DSBRDF
from dsbrdf.arrays import Array
from dsbrdf.components import DiffuseLayer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer
from dsbrdf.data.geometry import random_directions
from tests.support.mixtures import mixture
from tests.support.random_models import papers_model, random_model

MODELS = {
    "mixture": mixture(3, 0),
    "elongated rings and cusps": random_model(1),
    "student": random_model(2, family="student"),
    "paper": papers_model(),
}
COAT = SpecularLayer((0.04, 0.041, 0.042), 0.9, 0.05, 2.0, (0.2, -0.3), 0.4, 0.0)
METAL = SpecularLayer((0.9, 0.6, 0.3), 1.1, 0.3, 5.0, (-0.1, 0.2), 0.8, 1.0)
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
    return DSBRDF(
        np.zeros(1),
        np.full((3, 1, 1), np.expm1(kappa) if amplitude is None else amplitude),
        kappa * one,
        gamma * one,
        center * one,
        np.full((1, 1), elongation),
        delta=np.full((3, 1), delta),
        interpolation="linear",
        lobe=family,
    )


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
