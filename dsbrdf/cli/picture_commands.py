"""Commands that draw: ``dsbrdf render`` and ``compare`` lit spheres, ``dsbrdf plot`` figures of a stored model."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from dsbrdf.arrays import Array
from dsbrdf.cli.arguments import print_json, print_written
from dsbrdf.cli.commands import Whole
from dsbrdf.cli.parameters import (
    MEASUREMENTS,
    ComponentName,
    Json,
    ModelFile,
    OutputFile,
    RequiredFiles,
    SourceFile,
    named_in_errors,
    named_part,
    read_grid,
    read_model,
    read_source,
)
from dsbrdf.data.files import write_atomically
from dsbrdf.data.hdr_image import SUFFIXES
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import profiles
from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.fitting.metrics import METRICS
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.environment import EnvironmentMap, read_environment
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import LIGHTINGS, render_sphere, sphere_normals
from dsbrdf.output.figures import IMAGE_FORMATS, encode_figure, overview_figure, parameters_figure
from dsbrdf.output.report_text import lobes_phrase
from dsbrdf.output.sphere_panels import DIFFERENCE_GAIN, compare_spheres, encode_png, side_by_side


@Parameter(name="*")
@dataclass(frozen=True)
class Look:
    """How spheres are drawn.

    Attributes
    ----------
    lighting
        three_lights, environment, or a panorama of 360 by 180 degrees, .hdr or .exr.
    size
        Of a sphere [pixels].
    exposure
        What radiance is multiplied by before it is clipped at 1 and gets the sRGB curve; by default the 99th percentile
        of the whole material, or of the first source, becomes 1.
    """

    lighting: Annotated[str, Parameter(metavar="NAME|FILE")] = LIGHTINGS[0]
    size: Annotated[int, Whole, Parameter(metavar="PIXELS")] = 256
    component: ComponentName = None
    exposure: Annotated[float | None, Parameter(metavar="FACTOR")] = None

    def __post_init__(self) -> None:
        if self.lighting not in LIGHTINGS and not self.lighting.lower().endswith(SUFFIXES):
            raise InvalidArgumentError(
                f"--lighting: must be {', '.join(LIGHTINGS)} or a .hdr or .exr file, not {self.lighting!r}"
            )
        if self.exposure is not None and not 0.0 < self.exposure < float("inf"):
            raise InvalidArgumentError(f"the exposure must be a positive number, not {self.exposure:g}")

    def light(self) -> str | EnvironmentMap:
        """Return the name of the lighting, or the panorama; an error names its file."""
        if self.lighting in LIGHTINGS:
            return self.lighting
        with named_in_errors(Path(self.lighting)):
            return read_environment(self.lighting)


_USUAL = Look()


def render(*sources: RequiredFiles, output: OutputFile, look: Look = _USUAL, json: Json = False) -> None:
    """Draw a lit sphere of a model or a measurement.

    Parameters
    ----------
    sources
        A .json or .npz model, or a .binary or .bsdf measurement; a second one, a model, is compared with the first:
        the picture then shows both, their difference and the components of the model.
    output
        The file to write, a .png.
    """
    _check_png(output)
    if len(sources) > 2:
        raise InvalidArgumentError(f"one or two sources can be drawn, not {len(sources)}")
    image, about = _sphere(sources[0], look) if len(sources) == 1 else _comparison(sources[0], sources[1], look)
    write_atomically(output, [encode_png(image)])
    if json:
        print_json({"output": str(output), "lighting": look.lighting} | about)
        return
    print(f"{output}: {look.lighting}, radiance times {about['exposure']:.4g}, clipped at 1, sRGB curve")
    if "panels" in about:
        print(f"from left to right: {', '.join(about['panels'])}")
        psnr = "infinite" if about["psnr"] is None else f"{about['psnr']:.1f} dB"
        print(f"likeness of the first two: PSNR {psnr}, SSIM {about['ssim']:.4f}")


def _check_png(output: Path) -> None:
    if output.suffix.lower() != ".png":
        raise InvalidArgumentError(f"{output}: the picture's file must end in .png")


def _sphere(path: Path, look: Look) -> tuple[Array, dict[str, Any]]:
    """Picture of one source, or of one of its components, and what to report."""
    light, whole = look.light(), read_source(path)
    if look.component is not None and isinstance(whole, Measurement):
        raise InvalidArgumentError(f"{path}: a measurement has no components; fit it first")
    part = whole if isinstance(whole, Measurement) else named_part(path, whole, look.component)
    image = render_sphere(part, lighting=light, size=look.size)
    factor = look.exposure
    if factor is None:
        of_whole = image if part is whole else render_sphere(whole, lighting=light, size=look.size)
        factor = exposure(of_whole, sphere_normals(look.size)[1])
    return displayed(image, factor), {"exposure": factor}


def _comparison(first: Path, second: Path, look: Look) -> tuple[Array, dict[str, Any]]:
    """Panels of two sources, and what to report."""
    if look.component is not None:
        raise InvalidArgumentError("a comparison shows all components: leave --component out")
    light, measured, fit = look.light(), read_source(first), read_source(second)
    if not isinstance(fit, DSBRDF):
        raise InvalidArgumentError(f"{second}: the second source must be a model, the fit of the first")
    found = compare_spheres(measured, fit, lighting=light, size=look.size, factor=look.exposure)
    if isinstance(measured, DSBRDF):
        names = (first.stem, second.stem) if first.stem != second.stem else (str(first), str(second))
        titles = dict(zip(("measured", "fit"), names, strict=True))
        found = replace(found, panels={titles.get(title, title): panel for title, panel in found.panels.items()})
    psnr = found.psnr if np.isfinite(found.psnr) else None
    about = {"exposure": found.exposure, "panels": list(found.panels), "psnr": psnr, "ssim": found.ssim}
    return side_by_side(found.panels), about


def plot(
    model: ModelFile,
    measurement: Path | None = None,
    /,
    *,
    output: OutputFile,
    lobes: bool = False,
    json: Json = False,
) -> None:
    """Draw the fit of a measurement, or the parameters of a model.

    Parameters
    ----------
    measurement
        What was fitted: draws its profiles, the fit and the components; without it, the parameters over
        theta_diff.
    output
        The file to write: .png, .svg or .pdf.
    lobes
        Draw the lobes of the model instead of its components.
    """
    image_format = output.suffix.lower().removeprefix(".")
    if image_format not in IMAGE_FORMATS:
        raise InvalidArgumentError(
            f"{output}: the figure's file must end in {one_of([f'.{name}' for name in IMAGE_FORMATS])}"
        )
    fitted, _ = read_model(model)
    if measurement is None:
        figure = parameters_figure(fitted, title=model.stem, model_lobes=lobes)
    else:
        figure = overview_figure(profiles(read_grid(measurement)), fitted, model_lobes=lobes)
    write_atomically(output, [encode_figure(figure, image_format)])
    what = "parameters over theta_diff" if measurement is None else "profiles, fit and components"
    print_written(output, what, image_format, json=json)


def compare(first: SourceFile, second: SourceFile, /, *, output: OutputFile | None = None, json: Json = False) -> None:
    """Compare two models or measurements.

    Parameters
    ----------
    output
        Write a picture, a .png file: both spheres with the exposure of the first, and their difference.
    """
    if output is not None:
        _check_png(output)
    paths = (first, second)
    sources, columns = zip(*(_source(path) for path in paths), strict=True)
    found = compare_spheres(*sources, with_components=False)
    if output is not None:
        write_atomically(output, [encode_png(side_by_side(found.panels))])
    if json:
        likeness = {"psnr": found.psnr if np.isfinite(found.psnr) else None, "ssim": found.ssim}
        items = [{"file": str(path)} | column for path, column in zip(paths, columns, strict=True)]
        print_json({"items": items, "likeness": likeness, "output": None if output is None else str(output)})
        return
    print(f"{'':<16}" + "".join(f"{path.stem[-20:]:>22}" for path in paths))
    for name in columns[0]:
        print(f"{name:<16}" + "".join(f"{_cell(column[name]):>22}" for column in columns))
    print(f"likeness of their lit spheres: PSNR {found.psnr:.1f} dB, SSIM {found.ssim:.4f}")
    if output is not None:
        print(f"{output}: both spheres, and their difference times {DIFFERENCE_GAIN:g}")


def _source(path: Path) -> tuple[Any, dict[str, Any]]:
    """Read a model or a measurement, and return it with what is known of it."""
    if path.suffix.lower() in MEASUREMENTS:
        return read_grid(path), {"kind": "measurement", "numbers": None} | dict.fromkeys(METRICS)
    model, report = read_model(path)
    metrics = {name: None if report is None else report.metrics[name] for name in METRICS}
    return model, {"kind": lobes_phrase(model), "numbers": model.n_numbers} | metrics


def _cell(value: str | float | None) -> str:
    return "" if value is None else value if isinstance(value, str) else f"{value:.4g}"
