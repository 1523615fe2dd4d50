"""The figure that the paper does not have: materials between two others."""

import csv
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper import interpolation
from benchmarks.paper.interpolation import between
from benchmarks.paper.materials import Computed, Material
from benchmarks.paper.paper_figure import make
from dsbrdf import FitResult
from dsbrdf.model.lobes import fall_to_half
from tests.support.known_models import single_lobe


def coordinates(height: float, gamma: float, elongation: float) -> Computed:
    """One lobe with kappa 1, the same at all theta_diff, as the figure describes it."""
    knots = interpolation._KNOTS
    at = single_lobe(1.0, gamma, height, elongation=elongation).parameters_at(knots)
    reach = fall_to_half(at["kappa"][:, 0], "hemi_epd") / at["gamma"][:, 0]
    numbers = {"log_amplitude": np.log(at["amplitude"]), "log_kappa": np.log(at["kappa"][:, 0])}
    numbers |= {"log_reach": np.log(reach), "elongation": np.broadcast_to(at["elongation"], reach.shape)}
    return Computed("lobe", True, numbers)


def test_between_two_materials_height_and_reach_run_geometrically() -> None:
    first, second = coordinates(10.0, 400.0, 0.0), coordinates(0.1, 4.0, 1.0)
    for share, height, gamma, elongation in ((0.0, 10.0, 400.0, 0.0), (0.5, 1.0, 40.0, 0.5), (1.0, 0.1, 4.0, 1.0)):
        found = between(first, second, share).parameters_at(np.radians([0.0, 33.0, 88.0]))
        np.testing.assert_allclose(found["amplitude"], height, rtol=1e-9)
        np.testing.assert_allclose(found["gamma"], gamma, rtol=1e-9)
        np.testing.assert_allclose(found["elongation"], elongation, atol=1e-9)


def test_interpolation_shows_both_ways_for_each_pair(
    material: Material, two_lobe_fit: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interpolation, "fit_quietly", lambda *_: two_lobe_fit)
    monkeypatch.setattr(interpolation, "_SIZE", 16)
    monkeypatch.setattr(interpolation, "FRACTIONS_OF_SECOND", (0.0, 0.5, 1.0))
    (tmp_path / "other.binary").symlink_to(material.file)
    pair = [material, Material(tmp_path / "other.binary", tmp_path)]
    made = make(interpolation.FIGURE, pair, tmp_path)
    with (tmp_path / "interpolation.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["share"] for line in lines] == [str(share) for share in interpolation.FRACTIONS_OF_SECOND] * 2
    assert {line["other"] for line in lines} == {"other"}
    # Both are the same material: nothing changes on the way, and the fit is what is shown.
    angles = np.linspace(0.0, np.pi / 2, 1801)
    values = two_lobe_fit.model.evaluate(angles, 0.0).mean(axis=1)
    np.testing.assert_allclose([float(line["peak"]) for line in lines], values[0], rtol=1e-3)
    np.testing.assert_allclose([float(line["at_45_degrees"]) for line in lines], values[900], rtol=1e-3)
    assert interpolation.FIGURE.claims(made.computed)[0].found
