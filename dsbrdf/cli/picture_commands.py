"""Define the commands that draw models and measurements, or compare them: metrics and spheres side by side."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from dsbrdf.cli.arguments import print_json, print_written
from dsbrdf.cli.commands import Whole
from dsbrdf.cli.parameters import (
    NO_TABLE_FLAGS,
    AboutTable,
    ComponentName,
    Json,
    NumberOrAuto,
    OutputFile,
    RequiredFiles,
    SourceFile,
    is_measurement,
    named_in_errors,
    named_part,
    read_grid,
    read_measured,
    read_model,
    read_source,
)
from dsbrdf.components.decomposition import decompose
from dsbrdf.data.files import write_atomically
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.fitting.metrics import METRICS
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.figure_panels import IMAGE_FORMATS, encode_figure
from dsbrdf.output.figures import parameters_figure
from dsbrdf.output.plots import plot as plot_source
from dsbrdf.output.plots import plot_fit, samples_figure
from dsbrdf.output.report_text import lobes_phrase
from dsbrdf.output.sphere_panels import (
    Panels,
    compare_spheres,
    component_panels,
    encode_png,
    one_below_another,
    space_figure,
)
from dsbrdf.rendering.environment import EnvironmentMap, read_environment
from dsbrdf.rendering.space import space
from dsbrdf.rendering.sphere import LIGHTINGS, displayed, exposure, render_sphere, sphere_normals
from dsbrdf.samples.scattered_fit import relative_rms
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.samples.table_options import TableOptions


@Parameter(name="*")
@dataclass(frozen=True)
class Look:
    """Choose how spheres are drawn.

    Attributes
    ----------
    lighting
        three_lights, environment, or the .exr file of a panorama, 360 by 180 degrees.
    size
        Size of a sphere [pixels].
    exposure
        Multiply radiance by this factor before it is clipped at 1 and gets the sRGB curve; auto scales the 99th
        percentile of the whole material, or of the first source, to 1.
    """

    lighting: Annotated[str, Parameter(metavar="NAME|FILE")] = LIGHTINGS[0]
    size: Annotated[int, Whole, Parameter(metavar="PIXELS")] = 256
    component: ComponentName = None
    exposure: NumberOrAuto = "auto"

    def __post_init__(self) -> None:
        if self.lighting not in LIGHTINGS and Path(self.lighting).suffix.lower() != ".exr":
            raise InvalidArgumentError(
                f"--lighting: must be {', '.join(LIGHTINGS)} or an .exr file, not {self.lighting!r}"
            )
        if self.exposure != "auto" and not 0.0 < self.exposure < float("inf"):
            raise InvalidArgumentError(f"the exposure must be a positive number, not {self.exposure:g}")

    def light(self) -> str | EnvironmentMap:
        """Return the name of the lighting, or the panorama; an error names its file."""
        if self.lighting in LIGHTINGS:
            return self.lighting
        with named_in_errors(Path(self.lighting)):
            return read_environment(self.lighting)


USUAL_LOOK = Look()


def render(source: Path, /, *, output: OutputFile, look: Look = USUAL_LOOK, json: Json = False) -> None:
    """Draw a lit sphere of a model or a measurement.

    Parameters
    ----------
    source
        A .json model, or a .binary or .bsdf measurement.
    output
        The file to write, a .png.
    """
    check_png(output)
    light, whole = look.light(), read_source(source)
    if look.component is not None and isinstance(whole, Measurement):
        raise InvalidArgumentError(f"{source}: a measurement has no components; fit it first")
    part = whole if isinstance(whole, Measurement) else named_part(source, whole, look.component)
    image = render_sphere(part, lighting=light, size=look.size)
    factor = look.exposure
    if factor == "auto":
        of_whole = image if part is whole else render_sphere(whole, lighting=light, size=look.size)
        factor = exposure(of_whole, sphere_normals(look.size)[1])
    write_atomically(output, [encode_png(displayed(image, factor))])
    if json:
        print_json({"output": str(output), "lighting": look.lighting, "exposure": factor})
    else:
        print(f"{output}: {look.lighting}, radiance times {factor:.4g}, clipped at 1, sRGB curve")


def titles(paths: Sequence[Path]) -> list[str]:
    """Return titles for files: the names without folder and suffix, with numbers added to equal names."""
    stems = [path.stem for path in paths]
    return stems if len({*stems}) == len(stems) else [f"{stem} ({n})" for n, stem in enumerate(stems, 1)]


def check_png(output: Path) -> None:
    """Raise InvalidArgumentError unless the name of a picture ends in ``.png``."""
    if output.suffix.lower() != ".png":
        raise InvalidArgumentError(f"{output}: the picture's file must end in .png")


def plot(
    *files: RequiredFiles,
    output: OutputFile,
    lobes: bool = False,
    json: Json = False,
    table: AboutTable = NO_TABLE_FLAGS,
) -> None:
    """Draw the fit of a measurement, a measurement alone, the parameters of a model, or several materials.

    Parameters
    ----------
    files
        One model, for its parameters over theta_diff; one .binary or .bsdf measurement; a measurement or a table with
        its model, for the data beside the fit; or several other models and measurements, to compare their profiles
        and lit spheres.
    output
        The file to write: .png, .svg or .pdf.
    lobes
        Draw the lobes of the model instead of its components.
    """
    image_format = _figure_format(output)
    measurement, model = sorted(files, key=is_measurement, reverse=True) if len(files) == 2 else (None, files[0])
    if len(files) > 2 or (measurement and is_measurement(measurement) == is_measurement(model)):
        what = f"{len(files)} materials compared"
        figure = plot_source({name: read_source(path) for name, path in zip(titles(files), files, strict=True)})
    elif measurement is not None:
        what = "the fit beside what was measured"
        fitted, report = read_model(model)
        options = FitOptions() if report is None else report.options
        figure = plot_fit(fitted, read_measured(measurement, table), options, model_lobes=lobes)
    elif is_measurement(model):
        what, figure = "the measurement", plot_source(read_grid(model))
    else:
        what = "parameters over theta_diff"
        figure = parameters_figure(read_model(model)[0], title=model.stem, model_lobes=lobes)
    write_atomically(output, [encode_figure(figure, image_format)])
    print_written(output, what, image_format, json=json)


def map_materials(*files: RequiredFiles, output: OutputFile, json: Json = False) -> None:
    """Draw a map of materials by the likeness of their lit spheres, and list the three nearest materials of each.

    Parameters
    ----------
    files
        Models, measurements, or folders of models: all .json files in them.
    output
        The file to write: .png, .svg or .pdf.
    """
    image_format = _figure_format(output)
    found = [path for file in files for path in (sorted(file.glob("*.json")) if file.is_dir() else [file])]
    if len(found) < 2:
        raise InvalidArgumentError("a map needs at least two materials: name a folder of .json models, or files")
    names = [path.stem for path in found]
    if len({*names}) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InvalidArgumentError(f"two files are called {twice}: a map shows materials by the names of their files")
    models = {path.stem: read_source(path) for path in found}
    materials = space(models)
    write_atomically(output, [encode_figure(space_figure(materials, models), image_format)])
    if json:
        near = {name: [{"name": other, "db": db} for other, db in materials.nearest(name)] for name in names}
        places = dict(zip(names, materials.places.tolist(), strict=True))
        print_json({"items": [{"name": name, "place": places[name], "nearest": near[name]} for name in names]})
        return
    width = max(map(len, ("material", *names))) + 2
    print(f"{'material':<{width}}nearest, with the likeness of lit spheres but for colour and brightness")
    for name in names:
        print(f"{name:<{width}}" + ", ".join(f"{other} ({db:.1f} dB)" for other, db in materials.nearest(name)))
    print_written(output, f"a map of {len(names)} materials", image_format)


def _figure_format(output: Path) -> str:
    """Return the image format by the suffix of a file."""
    image_format = output.suffix.lower().removeprefix(".")
    if image_format not in IMAGE_FORMATS:
        raise InvalidArgumentError(
            f"{output}: the figure's file must end in {one_of([f'.{name}' for name in IMAGE_FORMATS])}"
        )
    return image_format


def compare(
    first: SourceFile,
    second: SourceFile,
    /,
    *more: SourceFile,
    output: OutputFile | None = None,
    look: Look = USUAL_LOOK,
    json: Json = False,
    table: AboutTable = NO_TABLE_FLAGS,
) -> None:
    """Compare models or measurements with the first one, or a table of samples with a model.

    Parameters
    ----------
    output
        Write a picture, a .png file: the spheres with the exposure of the first sphere, their differences from the
        first, and the components of models; or, for a table, the samples, the fit and the residual.
    """
    if output is not None:
        check_png(output)
    paths = (first, second, *more)
    sources, columns = zip(*(_source(path, table, look.component) for path in paths), strict=True)
    tables = [source for source in sources if isinstance(source, ScatteredSamples)]
    if tables:
        likeness, sentences, picture, shown = _samples_and_model(paths, sources, with_picture=output is not None)
    else:
        likeness, sentences, picture, shown = _spheres(paths, sources, look, with_picture=output is not None)
    if output is not None and picture is not None:
        write_atomically(output, [picture])
    if json:
        items = [{"file": str(path)} | column for path, column in zip(paths, columns, strict=True)]
        answer = likeness if len(likeness) > 1 else likeness[0]
        print_json({"items": items, "likeness": answer, "output": None if output is None else str(output)})
        return
    rows = list(dict.fromkeys(name for column in columns for name, value in column.items() if value is not None))
    width = max(map(len, rows)) + 2
    print(f"{'':<{width}}" + "".join(f"{path.stem[-20:]:>22}" for path in paths))
    for name in rows:
        if name == next((metric for metric in METRICS if metric in rows), None):
            print("each fit compared with its own measurement:")
        print(f"{name:<{width}}" + "".join(f"{_cell(column.get(name)):>22}" for column in columns))
    print(*sentences, sep="\n")
    if output is not None:
        print(f"{output}: {shown}")


_Comparison = tuple[list[dict[str, float | None]], list[str], bytes | None, str]
"""Likeness of each source to the first source, sentences about it, a picture, and a description of the picture."""


def _samples_and_model(paths: Sequence[Path], sources: Sequence[Any], *, with_picture: bool) -> _Comparison:
    samples = next(source for source in sources if isinstance(source, ScatteredSamples))
    others = [path for path, source in zip(paths, sources, strict=True) if source is not samples]
    if len(others) > 1:
        raise InvalidArgumentError("a table of samples can be compared with one model only: name one model")
    model, _ = read_model(others[0])
    error = relative_rms(model.evaluate_directions(samples.omega_in, samples.omega_out), samples.values, samples.weight)
    sentence = f"at the {len(samples.values)} samples: relative_rms {error:.4g}"
    picture = encode_figure(samples_figure(samples, model)) if with_picture else None
    return [{"relative_rms": error}], [sentence], picture, "samples, fit and residual"


def _spheres(paths: Sequence[Path], sources: Sequence[Any], look: Look, *, with_picture: bool) -> _Comparison:
    is_fit = len(paths) == 2 and isinstance(sources[0], Measurement) and isinstance(sources[1], DSBRDF)
    names = ["measured", "fit"] if is_fit and paths[0].stem == paths[1].stem else titles(paths)
    light, factor = look.light(), look.exposure
    likeness: list[dict[str, float | None]] = []
    sentences: list[str] = []
    rows: list[Panels] = [{}, {}] if len(paths) > 2 else [{}]
    for name, source in zip(names[1:], sources[1:], strict=True):
        found = compare_spheres(
            sources[0],
            source,
            names=(names[0], name),
            with_components=is_fit and with_picture,
            lighting=light,
            size=look.size,
            factor=factor,
        )
        factor = found.exposure
        likeness.append({"psnr": found.psnr if np.isfinite(found.psnr) else None, "ssim": found.ssim})
        spheres = "their lit spheres" if len(paths) == 2 else f"the lit spheres of {names[0]} and {name}"
        sentences.append(f"likeness of {spheres} {found.light}: PSNR {found.psnr:.1f} dB, SSIM {found.ssim:.4f}")
        panels = list(found.panels.items())
        rows[0] |= dict(panels[:2])
        rows[-1] |= {title if len(paths) == 2 else f"{name}: {title}": panel for title, panel in panels[2:]}
    if with_picture and not is_fit:
        models = [(name, source) for name, source in zip(names, sources, strict=True) if isinstance(source, DSBRDF)]
        rows += [component_panels(model, name, light, look.size, found.exposure or 1.0) for name, model in models]
    shown = f"{', '.join(title for row in rows for title in row)}; radiance times {found.exposure:.4g}"
    return likeness, sentences, encode_png(one_below_another(rows)) if with_picture else None, shown


def _source(path: Path, table: TableOptions, component: str | None) -> tuple[Any, dict[str, Any]]:
    """Read a model, a component of a model, or a measurement; return the object and its metrics by name."""
    if is_measurement(path):
        if component is not None:
            raise InvalidArgumentError(f"{path}: a measurement has no components; fit it first")
        measured = read_measured(path, table)
        return measured, {"kind": "measurement", "numbers": None} | dict.fromkeys(METRICS)
    model, report = read_model(path)
    if component is not None:
        return named_part(path, model, component), {"kind": component}
    about: dict[str, Any] = {"kind": lobes_phrase(model), "numbers": model.n_numbers}
    about |= {name: None if report is None else report.metrics[name] for name in METRICS}
    for part in decompose(model):
        name, alphas = part.label.replace("_", " "), [one.alpha for one in part.surfaces if one.alpha is not None]
        about |= {f"{name}: light": part.light_share, f"{name}: albedo": float(part.albedo.mean())}
        about |= {f"{name}: alpha": alphas[0]} if alphas else {}
    return model, about


def _cell(value: str | float | None) -> str:
    return "" if value is None else value if isinstance(value, str) else f"{value:.4g}"
