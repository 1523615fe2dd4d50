"""Figures 1 to 5: files are written, and the numbers in them are those of the data and the fits."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper import figure1, figure2, figure3, figure4, figure5
from benchmarks.paper.materials import Computed, Material, fit_quietly
from benchmarks.paper.paper_figure import PaperFigure, make
from benchmarks.paper.table_interpolation import thinned
from dsbrdf import DSBRDF, FitOptions, FitResult, InvalidArgumentError, Measurement, decompose, render_sphere
from dsbrdf.data import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF, above_horizon
from dsbrdf.rendering import sphere_likeness

Fits = dict[str, FitResult]
Lines = list[dict[str, str]]
MakeLines = Callable[[PaperFigure], Lines]


@pytest.fixture
def lines_of(material: Material, tmp_path: Path, small_spheres: int, coarse_pictures: None) -> MakeLines:
    """Make a figure, check its pictures, and return the lines of its CSV file."""

    def run(figure: PaperFigure) -> Lines:
        made = make(figure, figure.choose([material]), tmp_path)
        assert made.failures == []
        assert (tmp_path / f"{figure.name}.png").read_bytes() == made.picture
        assert made.picture.startswith(b"\x89PNG")
        assert "<svg" in (tmp_path / f"{figure.name}.svg").read_text()
        assert all(claim.found and claim.paper for claim in figure.claims(made.computed))
        with (tmp_path / f"{figure.name}.csv").open(newline="") as file:
            lines = list(csv.DictReader(file))
        assert {line["material"] for line in lines} == {"plastic"}
        assert {line["data"] for line in lines} == {"measured"}
        return lines

    return run


def column(lines: Lines, name: str) -> np.ndarray:
    return np.array([float(line[name]) for line in lines])


def relative_rms(model: DSBRDF, measurement: Measurement, rows: int = 90) -> float:
    """The metric from its definition, all samples of the first rows of theta_diff at once."""
    used = above_horizon(THETA_HALF[:, None, None], THETA_DIFF[:, None], PHI_DIFF, DEFAULT_HORIZON_CUTOFF)
    used = used & measurement.valid & (THETA_HALF >= np.radians(1.0))[:, None, None]
    used[:, rows:] = False
    data, fitted = measurement.values[:, used], model.tabulate()[:, used]
    return float(np.sqrt(np.sum((data - fitted) ** 2) / np.sum(data**2)))


def test_figure_1_tells_the_slice_and_the_lobes(lines_of: MakeLines, plastic: Measurement, quick_fits: Fits) -> None:
    lines = [line for line in lines_of(figure1.FIGURE) if line["channel"] == "green"]
    right = [line for line in lines if line["phi_diff_deg"] == "0"]
    left = [line for line in lines if line["phi_diff_deg"] == "90"]
    angles = np.radians(column(right, "theta_half_deg"))
    np.testing.assert_allclose(angles, THETA_HALF)
    np.testing.assert_allclose(column(left, "theta_half_deg"), -np.degrees(angles))
    np.testing.assert_allclose(column(right, "measured"), plastic.values[1, :, 0, 0])
    np.testing.assert_allclose(column(left, "measured"), plastic.values[1, :, 0, 90])
    paper = quick_fits["paper-3"].model
    np.testing.assert_allclose(column(right, "paper"), paper.evaluate(angles, 0.0)[:, 1])
    default = quick_fits["global-auto"].model.evaluate(angles, 0.0, np.pi / 2)[:, 1]
    np.testing.assert_allclose(column(left, "default"), default)
    for k in range(3):
        expected = np.expm1(paper.kappa[1, 0, k] * np.cos(angles) ** paper.gamma[1, 0, k])
        np.testing.assert_allclose(column(right, f"lobe_{k + 1}"), expected, rtol=1e-9, atol=1e-12)


def test_figure_2_compares_spheres(
    lines_of: MakeLines, plastic: Measurement, quick_fits: Fits, small_spheres: int
) -> None:
    lines = lines_of(figure2.FIGURE)
    assert [line["fit"] for line in lines if line["chosen_by_williams_test"] == "True"] == ["2 lobes"]
    reference = render_sphere(plastic, lighting="environment", size=small_spheres)
    for line, name in zip(lines, [*(f"paper-{k}" for k in range(1, 6)), "global-auto"], strict=True):
        result = quick_fits[name]
        picture = render_sphere(result.model, lighting="environment", size=small_spheres)
        assert (float(line["psnr_db"]), float(line["ssim"])) == pytest.approx(sphere_likeness(reference, picture))
        assert int(line["numbers"]) == result.model.n_numbers
    three = lines[2]
    assert float(three["relative_rms"]) == pytest.approx(relative_rms(quick_fits["paper-3"].model, plastic), rel=1e-6)


def test_figure_3_tells_colour_and_share_of_each_part(lines_of: MakeLines, quick_fits: Fits) -> None:
    lines = lines_of(figure3.FIGURE)
    angle = np.radians(30.0)
    paper, default = quick_fits["paper-3"].model, quick_fits["global-auto"].model
    whole = paper.albedo(angle)
    shares = column(lines[:3], "share_of_albedo")
    assert shares.sum() == pytest.approx(1.0, rel=1e-4)
    second = paper.select((1,), with_delta=False).albedo(angle)
    assert shares[1] == pytest.approx(second.sum() / whole.sum())
    found = decompose(default)
    assert [line["part"] for line in lines[3:]] == [label.replace("_", " ") for label in found.labels]
    diffuse = found["diffuse"].directional_albedo(angle)
    assert [float(lines[-1][f"albedo_{name}"]) for name in ("red", "green", "blue")] == pytest.approx(diffuse)
    assert float(lines[-1]["saturation"]) == pytest.approx(1.0 - diffuse.min() / diffuse.max())
    assert column(lines[3:], "share_of_albedo").sum() == pytest.approx(1.0, rel=1e-4)


def test_saturation_of_grey_black_and_a_pure_colour() -> None:
    found = figure3.saturation(np.array([[0.2, 0.2, 0.2], [0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.4, 0.3, 0.1]]))
    np.testing.assert_allclose(found, [0.0, 0.0, 1.0, 0.75])


def test_figure_4_tells_the_errors_of_both_fits(lines_of: MakeLines, plastic: Measurement, quick_fits: Fits) -> None:
    (line,) = lines_of(figure4.FIGURE)
    for name, kept in (("paper", "paper-auto"), ("default", "global-auto")):
        model = quick_fits[kept].model
        assert float(line[f"relative_rms_{name}"]) == pytest.approx(relative_rms(model, plastic), rel=1e-6)
        inner = float(line[f"relative_rms_{name}_to_75_deg"])
        assert inner == pytest.approx(relative_rms(model, plastic, 76), rel=1e-6)
        assert (int(line[f"n_lobes_{name}"]), int(line[f"n_numbers_{name}"])) == (model.n_lobes, model.n_numbers)


def test_figure_4_names_the_materials_on_which_the_default_fit_is_worse() -> None:
    def computed(name: str, paper: float, default: float) -> Computed:
        values = {"paper": paper, "default": default, "floor": 0.1, "symmetric_floor": 0.0}
        values |= {"paper_to_75_deg": paper, "default_to_75_deg": default, "floor_to_75_deg": 0.1}
        return Computed(name, False, {key: np.array(value) for key, value in values.items()})

    claim = figure4.FIGURE.claims([computed("good", 0.3, 0.1), computed("bad", 0.1, 0.2)])[2]
    assert claim.verdict == "differs"
    assert "1 of 2; exceptions: bad*" in claim.found
    assert figure4.FIGURE.claims([computed("good", 0.3, 0.1)])[2].verdict == "agrees"


def test_figure_5_tells_the_error_of_a_fit_of_fewer_rows(
    lines_of: MakeLines, plastic: Measurement, quick_fits: Fits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figure5, "FACTORS", (1, 4))
    quick = {
        "global": FitOptions(n_lobes=1, ring_lobes=0),
        "paper": FitOptions(method="paper", n_lobes=2, em_iterations=1),
    }
    monkeypatch.setattr(figure5, "fit_quietly", lambda data, options: fit_quietly(data, quick[options.method]))
    lines = lines_of(figure5.FIGURE)
    assert [line["factor"] for line in lines] == ["1", "4"]
    paper = quick_fits["paper-auto"].model
    assert float(lines[0]["relative_rms_paper"]) == pytest.approx(relative_rms(paper, plastic), rel=1e-6)
    assert float(lines[0]["relative_rms_table"]) == 0.0
    assert float(lines[0]["relative_rms_table_of_means"]) == pytest.approx(float(lines[0]["floor"]), rel=1e-6)
    sparse = fit_quietly(thinned(plastic, 4), quick["global"]).model
    assert float(lines[1]["relative_rms_default"]) == pytest.approx(relative_rms(sparse, plastic), rel=1e-6)
    assert 0.0 < float(lines[1]["relative_rms_table"]) < 1.0
    assert 0.0 < float(lines[1]["relative_rms_guided_table"]) < float(lines[1]["relative_rms_table"])


def test_figure_5_counts_the_factors_at_which_the_model_is_not_worse() -> None:
    table = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert figure5.won(np.full(7, 0.1), table) == [4, 8, 12, 16, 24]
    assert figure5.won(np.array([0.0, 0.1, 0.1, 0.3, np.nan, 0.1, 9.0]), table) == [1, 4, 16]


def test_figure_without_a_material_is_refused(material: Material, tmp_path: Path) -> None:
    bad = tmp_path / "bad.binary"
    bad.touch()
    with pytest.raises(InvalidArgumentError, match=r"figure1 needs at least 1 material, not 0; .*bad\.binary"):
        make(figure1.FIGURE, [Material(bad, tmp_path)], tmp_path)
