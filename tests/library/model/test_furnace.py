"""White furnace and reciprocity, against materials whose albedo is known."""

import numpy as np
import pytest

from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.furnace import white_furnace
from tests.support.mixtures import mixture


def lambertian(albedo: float) -> DSBRDF:
    """A lobe with gamma 1e-12 is a constant."""
    one = np.ones((1, 1, 1))
    return DSBRDF(np.zeros(1), amplitude=np.full((3, 1, 1), albedo / np.pi), kappa=one, gamma=1e-12 * one)


def test_albedo_of_a_lambertian_surface_is_the_same_at_all_angles() -> None:
    report = white_furnace(lambertian(0.8))
    assert report.albedo == pytest.approx(0.8, rel=1e-5)
    assert report.conserves_energy
    assert "no direction returns more than is received; the largest albedo is 0.800" in str(report)


def test_a_surface_that_returns_too_much_is_found() -> None:
    report = white_furnace(lambertian(1.1))
    assert not report.conserves_energy
    assert "some directions return more than is received" in str(report)


def test_models_are_reciprocal() -> None:
    assert white_furnace(mixture(3, 1)).reciprocity_error < 1e-9


def test_error_of_reciprocity_is_a_share_of_the_larger_value(monkeypatch: pytest.MonkeyPatch) -> None:
    def one_way(_: DSBRDF, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.where(first[:, :1] > second[:, :1], 2.0, 1.0) * np.ones(3)

    monkeypatch.setattr(DSBRDF, "evaluate_directions", one_way)
    assert white_furnace(lambertian(0.5)).reciprocity_error == 0.5
