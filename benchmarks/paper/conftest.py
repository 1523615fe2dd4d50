"""A material whose fits took little time: the figures do not care how good a fit is."""

from dataclasses import dataclass, field
from typing import Literal

import pytest
from matplotlib.figure import Figure

from benchmarks.paper import figure2, figure3, figure4, figure6, paper_figure
from benchmarks.paper.materials import Material, fit_quietly
from dsbrdf import FitOptions, FitResult, Measurement, fit, write_merl
from dsbrdf.output import encode_figure


@dataclass(frozen=True)
class FittedMaterial(Material):
    """A material with fits that were made before, by method and number of lobes."""

    fits: dict[str, FitResult] = field(default_factory=dict, compare=False)

    def fit(
        self, *, method: Literal["global", "paper"] = "global", n_lobes: int | Literal["auto"] = "auto"
    ) -> FitResult:
        return self.fits[f"{method}-{n_lobes}"]


@pytest.fixture(scope="session")
def two_lobe_fit(plastic: Measurement) -> FitResult:
    """A fit of the plastic with two lobes."""
    return fit(plastic, n_lobes=2, ring_lobes=0)


@pytest.fixture(scope="session")
def quick_fits(plastic: Measurement, two_lobe_fit: FitResult) -> dict[str, FitResult]:
    """Fits by method and number of lobes; "paper-auto" is the one with two."""
    found = {"global-auto": two_lobe_fit}
    for n_lobes in range(1, 6):
        options = FitOptions(method="paper", n_lobes=n_lobes, em_iterations=3)
        found[f"paper-{n_lobes}"] = fit_quietly(plastic, options)
    return found | {"paper-auto": found["paper-2"]}


@pytest.fixture(scope="session")
def material(
    plastic: Measurement, quick_fits: dict[str, FitResult], tmp_path_factory: pytest.TempPathFactory
) -> Material:
    """The plastic with its fits."""
    folder = tmp_path_factory.mktemp("materials")
    write_merl(folder / "plastic.binary", plastic)
    return FittedMaterial(folder / "plastic.binary", folder, fits=quick_fits)


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
