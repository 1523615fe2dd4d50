"""Define the commands that draw models and measurements."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

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
    is_measurement,
    named_in_errors,
    named_part,
    read_grid,
    read_measured,
    read_model,
    read_source,
)
from dsbrdf.data.files import write_atomically
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.fitting.options import FitOptions
from dsbrdf.output.figure_panels import IMAGE_FORMATS, encode_figure
from dsbrdf.output.figures import parameters_figure
from dsbrdf.output.plots import plot as plot_source
from dsbrdf.output.plots import plot_fit
from dsbrdf.output.sphere_panels import encode_png, space_figure
from dsbrdf.rendering.environment import EnvironmentMap, read_environment
from dsbrdf.rendering.space import space
from dsbrdf.rendering.sphere import LIGHTINGS, displayed, exposure, render_sphere, sphere_normals


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
            known = ", ".join(LIGHTINGS)
            raise InvalidArgumentError(f"--lighting: must be {known} or an .exr file, not {self.lighting!r}")
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
    image_format = output.suffix.lower().removeprefix(".")
    if image_format in IMAGE_FORMATS:
        return image_format
    known = one_of([f".{name}" for name in IMAGE_FORMATS])
    raise InvalidArgumentError(f"{output}: the figure's file must end in {known}")
