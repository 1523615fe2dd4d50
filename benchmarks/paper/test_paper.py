"""The numbers of the figures are those of the data and the fits, found another way."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from benchmarks.paper import base, figure1, figure2, figure3, figure4, figure5, figure6
from benchmarks.paper.__main__ import main
from benchmarks.paper.base import Computed, Material, PaperFigure, find_materials, fit_quietly, preferred
from benchmarks.paper.table_interpolation import (
    guided_table_error,
    interpolated_rows,
    means_over_phi,
    table_error,
    thinned,
)
from dsbrdf import DSBRDF, FitOptions, FitResult, Measurement, decompose, fit, profiles, render_sphere, write_merl
from dsbrdf.data import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF, above_horizon
from dsbrdf.rendering import sphere_likeness

Fits = dict[str, FitResult]
SIZE = 16  # pixels of a sphere


@dataclass(frozen=True)
class FittedMaterial(Material):
    """A material with fits that were made before, by method and number of lobes."""

    fits: Fits = field(default_factory=dict, compare=False)

    def fit(
        self, *, method: Literal["global", "paper"] = "global", n_lobes: int | Literal["auto"] = "auto"
    ) -> FitResult:
        return self.fits[f"{method}-{n_lobes}"]


@pytest.fixture(scope="module")
def fits(plastic: Measurement) -> Fits:
    """Fits that take little time by method and number of lobes; "paper-auto" is the one with two."""
    found = {"global-auto": fit(plastic, n_lobes=2, ring_lobes=0)}
    for n_lobes in range(1, 6):
        options = FitOptions(method="paper", n_lobes=n_lobes, em_iterations=3)
        found[f"paper-{n_lobes}"] = fit_quietly(plastic, options)
    return found | {"paper-auto": found["paper-2"]}


@pytest.fixture(scope="module")
def material(plastic: Measurement, fits: Fits, tmp_path_factory: pytest.TempPathFactory) -> Material:
    folder = tmp_path_factory.mktemp("materials")
    write_merl(folder / "plastic.binary", plastic)
    return FittedMaterial(folder / "plastic.binary", folder, fits=fits)


@pytest.fixture(autouse=True)
def small_spheres(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (figure2, figure3, figure4, figure6):
        monkeypatch.setattr(module, "_SIZE", SIZE)


def computed_for(figure: PaperFigure, material: Material) -> list[Computed]:
    return [Computed("plastic", True, figure.measure(material))]


def column(rows: Sequence[Any], name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in rows])


def used_samples(measurement: Measurement, rows: int = 90) -> np.ndarray:
    used = above_horizon(THETA_HALF[:, None, None], THETA_DIFF[:, None], PHI_DIFF, DEFAULT_HORIZON_CUTOFF)
    used = used & measurement.valid & (THETA_HALF >= np.radians(1.0))[:, None, None]
    used[:, rows:] = False
    return used


def relative_rms(model: DSBRDF, measurement: Measurement, rows: int = 90) -> float:
    """The metric from its definition, all samples of the first rows of theta_diff at once."""
    used = used_samples(measurement, rows)
    data, fitted = measurement.values[:, used], model.tabulate()[:, used]
    return float(np.sqrt(np.sum((data - fitted) ** 2) / np.sum(data**2)))


def test_a_figure_is_written_and_its_fits_are_kept(
    material: Material, fits: Fits, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (material.file.parent / "bad.binary").touch()
    monkeypatch.setattr(base, "fit_quietly", lambda _, options: fits[f"{options.method}-{options.n_lobes}"])
    words = ["figure1", "--data", str(material.file.parent), "-o", str(tmp_path), "--jobs", "1"]
    assert main(words) == 0
    monkeypatch.setattr(base, "fit_quietly", lambda *_: pytest.fail("the fit is kept"))
    assert main(words) == 0
    said = capsys.readouterr()
    assert "agrees: Each lobe clearly captures" in said.out
    assert "bad.binary: " in said.err
    assert {"figure1.csv", "figure1.png", "figure1.svg"} < {path.name for path in tmp_path.iterdir()}
    with (tmp_path / "figure1.csv").open(newline="") as file:
        assert {line["material"] for line in csv.DictReader(file)} == {"plastic"}


def test_materials_are_found_and_chosen_by_their_names(tmp_path: Path) -> None:
    for name in ("merl_brass", "merl_nickel", "rgl_satin", "steel"):
        (tmp_path / f"{name}.binary").touch()
    found = find_materials(tmp_path, tmp_path)
    assert [one.measured for one in found] == [False, False, True, True]
    assert [one.name for one in find_materials(tmp_path, tmp_path, ["nickel", "steel"])] == ["merl_nickel", "steel"]
    assert [one.name for one in preferred(found, ("steel", "gold", "nickel"), 2)] == ["steel", "merl_nickel"]
    assert [one.name for one in preferred(found, ("nickel",), 3)] == ["merl_nickel", "merl_brass", "steel"]
    with pytest.raises(SystemExit, match="contains no material gold"):
        find_materials(tmp_path, tmp_path, ["gold"])


def test_figure_1_tells_the_slice_and_the_lobes(material: Material, plastic: Measurement, fits: Fits) -> None:
    rows: list[Any] = [row for row in figure1.table(computed_for(figure1, material)) if row["channel"] == "green"]
    right, left = ([row for row in rows if row["phi_diff_deg"] == phi] for phi in (0, 90))
    np.testing.assert_allclose(np.radians(column(right, "theta_half_deg")), THETA_HALF)
    np.testing.assert_allclose(column(left, "theta_half_deg"), -np.degrees(THETA_HALF))
    np.testing.assert_allclose(column(right, "measured"), plastic.values[1, :, 0, 0])
    np.testing.assert_allclose(column(left, "measured"), plastic.values[1, :, 0, 90])
    paper = fits["paper-3"].model
    np.testing.assert_allclose(column(right, "paper"), paper.evaluate(THETA_HALF, 0.0)[:, 1])
    for k in range(3):
        expected = np.expm1(paper.kappa[1, 0, k] * np.cos(THETA_HALF) ** paper.gamma[1, 0, k])
        np.testing.assert_allclose(column(right, f"lobe_{k + 1}"), expected, rtol=1e-9, atol=1e-12)


def test_figure_2_compares_spheres(material: Material, plastic: Measurement, fits: Fits) -> None:
    rows: list[Any] = figure2.table(computed_for(figure2, material))
    assert [row["fit"] for row in rows if row["chosen_by_williams_test"]] == ["2 lobes"]
    reference = render_sphere(plastic, lighting="environment", size=SIZE)
    for row, name in zip(rows, [*(f"paper-{k}" for k in range(1, 6)), "global-auto"], strict=True):
        picture = render_sphere(fits[name].model, lighting="environment", size=SIZE)
        assert (row["psnr_db"], row["ssim"]) == pytest.approx(sphere_likeness(reference, picture))
        assert row["numbers"] == fits[name].model.n_numbers


def test_figure_3_tells_colour_and_fraction_of_each_part(material: Material, fits: Fits) -> None:
    rows: list[Any] = figure3.table(computed_for(figure3, material))
    angle, paper, found = np.radians(30.0), fits["paper-3"].model, decompose(fits["global-auto"].model)
    assert column(rows[:3], "share_of_albedo").sum() == pytest.approx(1.0, rel=1e-4)
    second = paper.select((1,), with_delta=False).albedo(angle)
    assert rows[1]["share_of_albedo"] == pytest.approx(second.sum() / paper.albedo(angle).sum())
    assert [row["part"] for row in rows[3:]] == [label.replace("_", " ") for label in found.labels]
    diffuse = found["diffuse"].directional_albedo(angle)
    assert rows[-1]["saturation"] == pytest.approx(1.0 - diffuse.min() / diffuse.max())


def test_figure_4_tells_the_errors_of_both_fits(material: Material, plastic: Measurement, fits: Fits) -> None:
    (row,) = figure4.table(computed_for(figure4, material))
    for name, kept in (("paper", "paper-auto"), ("default", "global-auto")):
        model = fits[kept].model
        assert row[f"relative_rms_{name}"] == pytest.approx(relative_rms(model, plastic), rel=1e-6)
        assert row[f"relative_rms_{name}_to_75_deg"] == pytest.approx(relative_rms(model, plastic, 76), rel=1e-6)


def test_figure_5_tells_the_error_of_a_fit_of_fewer_rows(
    material: Material, plastic: Measurement, fits: Fits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figure5, "FACTORS", (1, 4))
    quick = {"global": FitOptions(n_lobes=1, ring_lobes=0), "paper": FitOptions(method="paper", n_lobes=1)}
    monkeypatch.setattr(figure5, "fit_quietly", lambda data, options: fit_quietly(data, quick[options.method]))
    whole, every_fourth = figure5.table(computed_for(figure5, material))
    paper = fits["paper-auto"].model
    assert whole["relative_rms_paper"] == pytest.approx(relative_rms(paper, plastic), rel=1e-6)
    assert whole["relative_rms_table"] == 0.0
    assert whole["relative_rms_table_of_means"] == pytest.approx(whole["floor"], rel=1e-6)
    sparse = fit_quietly(thinned(plastic, 4), quick["global"]).model
    assert every_fourth["relative_rms_default"] == pytest.approx(relative_rms(sparse, plastic), rel=1e-6)


def test_figure_6_embeds_few_materials_by_classical_scaling() -> None:
    generator = np.random.default_rng(3)
    materials = []
    for index in range(6):
        numbers = {"parameters": generator.normal(size=(3, 18, 3, 2)), "gloss": np.array(float(index))}
        numbers["sphere"] = np.zeros((SIZE, SIZE, 3), np.uint8)
        materials.append(Computed(f"material_{index}", True, numbers))
    rows = np.array([one["parameters"][:, 0].ravel() for one in materials])
    rows = rows / rows.std(axis=0)
    distances = np.linalg.norm(rows[:, None] - rows, axis=2)
    # Each material is a neighbour of all others, so that geodesics are straight lines.
    centre = np.eye(6) - 1.0 / 6.0
    values, vectors = np.linalg.eigh(-0.5 * centre @ distances**2 @ centre)
    expected = vectors[:, :-3:-1] * np.sqrt(values[:-3:-1])
    found = figure6.embedding(materials, "theta_diff_0")
    np.testing.assert_allclose(np.abs(found), np.abs(expected), rtol=1e-6, atol=1e-8)
    assert found[:, 0] @ np.arange(6.0) > 0.0
    assert figure6.nearest(materials, "theta_diff_0") == np.argsort(distances, axis=1)[:, 1:4].tolist()
    assert len(figure6.table(materials)) == 6
    assert len(figure6.claims(materials)) == 3


@pytest.mark.parametrize("coordinate", [THETA_HALF, np.arange(90.0)], ids=["angle", "index"])
def test_rows_are_interpolated_linearly(plastic: Measurement, coordinate: np.ndarray) -> None:
    predict, kept = interpolated_rows(thinned(plastic, 8), coordinate), np.arange(90) % 8 == 0
    for row in (3, 17, 60, 89):
        predicted = predict(row)
        for diff, phi in ((0, 0), (30, 45), (60, 90), (80, 170)):
            known = kept & plastic.valid[:, diff, phi]
            line = plastic.values[0, known, diff, phi]
            expected = np.interp(coordinate[row], coordinate[known], line)
            assert predicted[0, diff, phi] == pytest.approx(expected, rel=1e-12)


def test_errors_of_tables(plastic: Measurement) -> None:
    summary, means = profiles(plastic), means_over_phi(plastic)
    used = summary.weight > 0
    np.testing.assert_allclose(means.values[..., 0].swapaxes(1, 2)[used], summary.mean[used], rtol=1e-12)
    samples = used_samples(plastic)
    values = np.where(samples, plastic.values, np.nan)[:, samples.any(axis=2)]
    deviation = values - np.nanmean(values, axis=-1, keepdims=True)
    floor = float(np.sqrt(np.nansum(deviation**2) / np.nansum(values**2)))
    assert table_error(plastic, means) == pytest.approx(floor, rel=1e-9)
    few, fewer = thinned(plastic, 15), thinned(plastic, 30)
    assert guided_table_error(few, fewer, plastic.values) == pytest.approx(0.0, abs=1e-12)
    assert guided_table_error(few, fewer, np.zeros_like(plastic.stored)) == pytest.approx(table_error(few, fewer))
