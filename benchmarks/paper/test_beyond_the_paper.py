"""The figures that the paper does not have: footprint, and materials between two others."""

import csv
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper import footprint, interpolation, materials
from benchmarks.paper.footprint import SmallTable
from benchmarks.paper.ggx import GGXModel
from benchmarks.paper.interpolation import between
from benchmarks.paper.materials import Computed, Material, find_materials
from benchmarks.paper.paper_figure import make
from benchmarks.paper.table_interpolation import thinned
from dsbrdf.data.geometry import above_horizon
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import profiles
from dsbrdf.fitting.report import FitResult
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
    monkeypatch.setattr(interpolation, "STEPS", (0.0, 0.5, 1.0))
    (tmp_path / "other.binary").symlink_to(material.file)
    pair = [material, Material(tmp_path / "other.binary", tmp_path)]
    made = make(interpolation.FIGURE, pair, tmp_path)
    with (tmp_path / "interpolation.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["share"] for line in lines] == [str(share) for share in interpolation.STEPS] * 2
    assert {line["other"] for line in lines} == {"other"}
    # Both are the same material: nothing changes on the way, and the fit is what is shown.
    angles = np.linspace(0.0, np.pi / 2, 1801)
    values = two_lobe_fit.model.evaluate(angles, 0.0).mean(axis=1)
    np.testing.assert_allclose([float(line["peak"]) for line in lines], values[0], rtol=1e-3)
    np.testing.assert_allclose([float(line["at_45_degrees"]) for line in lines], values[900], rtol=1e-3)
    assert interpolation.FIGURE.claims(made.computed)[0].found


def test_a_small_table_with_all_nodes_is_the_table_of_means(plastic: Measurement) -> None:
    data = profiles(plastic, horizon_cutoff=None)
    table = SmallTable.of(data, 90)
    i, j = np.array([3, 20, 60]), np.array([10, 45, 3])
    found = table.evaluate(THETA_HALF[i], THETA_DIFF[j], np.zeros(3))
    np.testing.assert_allclose(found.T, data.mean[:, j, i], rtol=1e-9)
    assert SmallTable.of(data, 4).n_numbers == 48


def test_footprint_tells_numbers_and_errors_of_each_way(
    material: Material, plastic: Measurement, two_lobe_fit: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few_rows = thinned(plastic, 15)
    for module in (materials, footprint):
        monkeypatch.setattr(module, "read_merl", lambda _: few_rows)
    lambertian = GGXModel(np.full(3, 0.2), np.array([0.3]), np.zeros((3, 1)), np.zeros((3, 1)))
    monkeypatch.setattr(footprint, "fit_quietly", lambda *_: two_lobe_fit)
    monkeypatch.setattr(footprint, "fit_ggx", lambda *_: lambertian)
    for name, few in (("LOBES", (1,)), ("GGX_LOBES", (1,)), ("TABLE_SIDES", (4,)), ("_SIZE", 16)):
        monkeypatch.setattr(footprint, name, few)
    with_peer = Material(material.file, material.kept, peer=material.file)
    made = make(footprint.FIGURE, [with_peer], tmp_path)
    with (tmp_path / "footprint.csv").open(newline="") as file:
        lines = {line["way"]: line for line in csv.DictReader(file)}
    assert {way: int(line["numbers"]) for way, line in lines.items()} == {
        "default fit": two_lobe_fit.model.n_numbers,
        "parametric fit": two_lobe_fit.model.n_numbers,
        "GGX lobes": lambertian.n_numbers,
        "table": 48,
        "neural encoding": 675,
    }
    assert float(lines["neural encoding"]["relative_rms"]) < 1e-3  # the peer is the material itself
    values = plastic.values
    used = above_horizon(THETA_HALF[:, None, None], THETA_DIFF[:, None], PHI_DIFF, DEFAULT_HORIZON_CUTOFF)
    used = used & few_rows.valid & (THETA_HALF >= np.radians(1.0))[:, None, None]
    error = np.sqrt(np.sum((values[:, used] - 0.2 / np.pi) ** 2) / np.sum(values[:, used] ** 2))
    assert float(lines["GGX lobes"]["relative_rms"]) == pytest.approx(float(error), rel=1e-6)
    assert [claim.verdict for claim in footprint.FIGURE.claims(made.computed)][-1] == "differs"


def test_materials_find_their_peers(tmp_path: Path) -> None:
    for name in ("data/satin.binary", "data/felt.binary", "peers/peer_satin.binary"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    felt, satin = find_materials(tmp_path / "data", tmp_path, peers=tmp_path / "peers")
    assert (felt.peer, satin.peer) == (None, tmp_path / "peers" / "peer_satin.binary")
