"""A material whose kept fits took little time: the figures do not care how good a fit is."""

from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from dsbrdf.data.measurement import Measurement
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.figures import encode_figure
from dsbrdf.output.serialize import save
from dsbrdf.paper import figure2, figure3, figure4, figure6, paper_figure
from dsbrdf.paper.materials import Material, fit_quietly


@pytest.fixture(scope="session")
def quick_fits(plastic: Measurement, two_lobe_fit: FitResult) -> dict[str, FitResult]:
    """Fits by the names under which they are kept; "paper-auto" is the one with two lobes."""
    found = {"global-auto": _as_if(two_lobe_fit, FitOptions())}
    for n_lobes in range(1, 6):
        result = fit_quietly(plastic, FitOptions(method="paper", n_lobes=n_lobes, em_iterations=3))
        found[f"paper-{n_lobes}"] = _as_if(result, FitOptions(method="paper", n_lobes=n_lobes))
    found["paper-auto"] = _as_if(found["paper-2"], FitOptions(method="paper"))
    return found


def _as_if(result: FitResult, options: FitOptions) -> FitResult:
    """A fit that claims to have been made with other options."""
    return FitResult(result.model, replace(result.report, options=options))


@pytest.fixture(scope="session")
def material(
    plastic_file: Path, quick_fits: dict[str, FitResult], tmp_path_factory: pytest.TempPathFactory
) -> Material:
    """The plastic with its fits kept."""
    kept = tmp_path_factory.mktemp("kept")
    for name, result in quick_fits.items():
        save(result, kept / f"plastic.{name}.json")
    return Material(plastic_file, kept)


@pytest.fixture
def small_spheres(monkeypatch: pytest.MonkeyPatch) -> int:
    """Size of the figures' spheres, smaller than usual."""
    for module in (figure2, figure3, figure4, figure6):
        monkeypatch.setattr(module, "_SIZE", 16)
    return 16


@pytest.fixture
def coarse_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the figures have a tenth of the usual number of pixels."""

    def coarse(figure: Figure, image_format: str = "png", *, dpi: float = 110.0) -> bytes:
        return encode_figure(figure, image_format, dpi=dpi / 3.0)

    monkeypatch.setattr(paper_figure, "encode_figure", coarse)
