"""Define the commands that print and export models, and convert measurements."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from dsbrdf.cli.arguments import print_error, print_json, print_written
from dsbrdf.cli.parameters import (
    NO_TABLE_FLAGS,
    AboutTable,
    ComponentName,
    Json,
    ModelFile,
    OutputFile,
    Points,
    RequiredFiles,
    check_output,
    named_in_errors,
    named_part,
    read_model,
)
from dsbrdf.data.files import write_atomically
from dsbrdf.data.geometry import CHANNELS, spherical
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import encode_merl, read_merl
from dsbrdf.data.rgl import RglMaterial, read_rgl
from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.atlas import load_material, materials
from dsbrdf.output.documents import component_documents, component_rows, table_csv, table_latex
from dsbrdf.output.export import FORMATS, export_model, format_of
from dsbrdf.output.export import example as example_of
from dsbrdf.output.export.glsl import NAME
from dsbrdf.output.export.rgl import rgl_bsdf
from dsbrdf.output.report_text import lobes_phrase, model_text, result_document, result_text
from dsbrdf.output.serialize import save
from dsbrdf.pipeline import fit
from dsbrdf.result import FitResult
from dsbrdf.samples.reading import kind_of_file, read_samples
from dsbrdf.samples.scattered_samples import CANONICAL
from dsbrdf.samples.table_options import TableOptions

_FORMAT_HELP = "; ".join(f"{name}: {kind.purpose}" for name, kind in FORMATS.items())
Format = Annotated[
    str,
    Parameter(
        name="--format",
        metavar="FORMAT",
        choices=("auto", *FORMATS),
        show_choices=False,
        help=f"auto: by the file's suffix; {_FORMAT_HELP}. Each can hold the layers, those with values "
        "also one component.",
    ),
]

_NO_POINTS = Points()


def evaluate(
    model: ModelFile, /, *, points: Points = _NO_POINTS, component: ComponentName = None, json: Json = False
) -> None:
    """Print values of a model or of one of its components."""
    part = named_part(model, read_model(model)[0], component)
    columns = points.arrays()
    if "theta_in_deg" in columns:
        theta_in, theta_out, phi_out = (np.radians(angles) for angles in columns.values())
        values = part.evaluate_directions(spherical(theta_in, 0.0), spherical(theta_out, phi_out))
    elif "omega_in" in columns:
        values = part.evaluate_directions(columns["omega_in"], columns["omega_out"])
    else:
        values = part.evaluate(*(np.radians(angles) for angles in columns.values()))
    if json:
        print_json({name: array.tolist() for name, array in columns.items()} | {"values": values.tolist()})
        return
    rows = [
        [",".join(f"{number:.6g}" for number in np.ravel(part)) for part in point]
        for point in zip(*columns.values(), strict=True)
    ]
    heads = [name.removesuffix("_deg") for name in columns]
    widths = [max(map(len, column)) + 2 for column in zip(heads, *rows, strict=True)]
    widths[0] -= 2
    # A table too wide for the terminal gets narrower columns with fewer digits; JSON has all digits.
    number = 12 if sum(widths) + 36 <= shutil.get_terminal_size().columns else 9
    print(_aligned(heads, widths) + "".join(f"{channel:>{number}}" for channel in CHANNELS))
    for row, value in zip(rows, values, strict=True):
        print(_aligned(row, widths) + "".join(f"{one:>{number}.{6 if number == 12 else 3}g}" for one in value))


def _aligned(cells: Sequence[str], widths: Sequence[int]) -> str:
    return "".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))


def show(*models: RequiredFiles, json: Json = False) -> None:
    """Print the reports of fits again.

    Parameters
    ----------
    models
        A .json file from dsbrdf fit, or several.
    """
    stored = {model: read_model(model) for model in models}
    if json:
        documents = [{"file": str(model)} | result_document(*found) for model, found in stored.items()]
        print_json(documents[0] if len(models) == 1 else {"items": documents})
        return
    for model, (found, report) in stored.items():
        if report is None:
            print(f"{model.stem}: {lobes_phrase(found)}", "", *model_text(found), sep="\n")
        else:
            print(*result_text(model, FitResult(found, report)), sep="\n")


def print_materials(
    name: Annotated[str | None, Parameter(metavar="MATERIAL")] = None,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"), metavar="FILE")] = None,
    json: Json = False,
) -> None:
    """Print the measured materials whose fits come with the package, or write the fit of one to a file.

    Parameters
    ----------
    name
        One of the materials.
    output
        The .json file of the fit.
    """
    if (name is None) != (output is None):
        raise InvalidArgumentError("to write the fit of a material, give its name and --output FILE")
    if name is not None and output is not None:
        save(load_material(name), output)
        print_written(output, f"fit of {name}", "json", json=json)
        return
    fits = {one: load_material(one) for one in materials()}
    if json:
        print_json({"items": [{"name": one, "psnr": fit.report.metrics.psnr} for one, fit in fits.items()]})
        return
    print(f"{'material':<20}{'PSNR':>8}   {'model'}")
    for one, found in fits.items():
        print(f"{one:<20}{found.report.metrics.psnr:>5.1f} dB   {lobes_phrase(found.model)}")


def print_components(
    *models: RequiredFiles,
    csv: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    latex: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    json: Json = False,
) -> None:
    """Print the components of models and their surfaces.

    Parameters
    ----------
    models
        A .json file from dsbrdf fit, or several.
    csv
        Write a table with a row for each surface and each diffuse part.
    latex
        Write the same table for LaTeX, with the package booktabs.
    """
    stored = {model: read_model(model) for model in models}
    parts = {model: component_documents(found) for model, (found, _) in stored.items()}
    rows: list[dict[str, Any]] = []
    for model, (_, report) in stored.items():
        rows += component_rows(model.stem, parts[model], None if report is None else report.metrics.psnr)
    for file, encode in ((csv, table_csv), (latex, table_latex)):
        if file is not None:
            content = encode(rows)
            check_output(file, models, content)
            write_atomically(file, [content])
    if json:
        items = [{"file": str(model), "items": own} for model, own in parts.items()]
        print_json({"items": parts[models[0]]} if len(models) == 1 else {"items": items})
        return
    for model, (found, _) in stored.items():
        print(*([f"{model.stem}:"] if len(models) > 1 else []), *model_text(found), "", sep="\n")


def export(
    model: ModelFile,
    /,
    *,
    file_format: Format = "auto",
    output: OutputFile,
    component: ComponentName = None,
    name: str | None = None,
    sampling: bool = False,
    example: bool = False,
    json: Json = False,
) -> None:
    """Write a model, or one of its components, for other programs.

    Parameters
    ----------
    output
        The file to write.
    name
        Name of the function in GLSL; all other names in the file begin with it, so that a shader can hold several
        materials.
    sampling
        Add functions to GLSL that draw directions and return their density.
    example
        Also write an example that shows the file on a sphere: a page for a browser (glsl), a scene for Mitsuba (bsdf)
        or pbrt (bsdf-spectral), a script for Blender (materialx).
    """
    kind = format_of(output) if file_format == "auto" else file_format
    stored, report = read_model(model)
    part = named_part(model, stored, component)
    stored_report = report if component is None else None
    content = export_model(part, kind, stored_report, name=name, sampling=sampling, title=output.stem)
    check_output(output, [model], content)
    shown = [example_of(output, kind, content, name or NAME)] if example else []
    for file, what in ((output, content), *shown):
        write_atomically(file, [what])
    of = "" if component is None else f", {component.replace('_', ' ')} alone"
    print_written(output, f"{FORMATS[kind].purpose.partition(' (')[0]}{of}", kind, json=json)
    for file, _ in () if json else shown:
        print_written(file, "an example that shows it")


_WRITTEN = {".binary": "a MERL table", ".bsdf": "an RGL file", ".csv": "a file of samples"}
# A warning is printed if the values of both orders of directions differ more, because a MERL table stores their mean.
_MAX_RECIPROCITY_ERROR = 0.1


def convert(
    *paths: RequiredFiles, spectral: bool = False, json: Json = False, table: AboutTable = NO_TABLE_FLAGS
) -> None:
    """Write a measurement as another kind of file.

    Parameters
    ----------
    paths
        The measurement, then the file to write: .bsdf is for Mitsuba 3, .binary a MERL table, .csv a file of
        samples. A table of samples is fitted first for .bsdf and .binary, which have the values of the fit; several
        tables of one material are joined into one measurement.
    spectral
        Store spectra in the .bsdf file, for pbrt-v4 and spectral variants of Mitsuba.
    """
    *sources, target = paths
    suffix = target.suffix.lower()
    if suffix not in _WRITTEN:
        raise InvalidArgumentError(f"{target}: the output must end in {one_of(tuple(_WRITTEN))}")
    if not sources:
        raise InvalidArgumentError(f"there is nothing to convert to {target}: name the measurement before it")
    source = sources[0]
    # In "dsbrdf convert *.csv" the last table would be the file to write.
    is_table = suffix == ".csv" and target.is_file() and not target.read_bytes().startswith(CANONICAL)
    check_output(target, [*sources, *([target] if is_table else [])])
    with named_in_errors(source):
        content, sentences, about = _converted(sources, suffix, table.options(), spectral=spectral)
    write_atomically(target, [content])
    for sentence in sentences:
        print_error(f"warning: {source}: {sentence}")
    print_written(target, _WRITTEN[suffix], suffix[1:], json=json, **about)
    if about and not json:
        print(f"{target}: " + "; ".join(f"{name.replace('_', ' ')} {value:.1%}" for name, value in about.items()))


def _converted(
    sources: Sequence[Path], suffix: str, options: TableOptions, *, spectral: bool
) -> tuple[bytes, tuple[str, ...], dict[str, Any]]:
    """Return the content of the converted file, warnings for the user, and measures of error by name."""
    found: Measurement | RglMaterial | DSBRDF
    sentences: tuple[str, ...] = ()
    about: dict[str, Any] = {}
    source, kind = sources[0], kind_of_file(sources[0])
    if kind == "samples":
        samples = read_samples(sources, options)
        if suffix == ".csv":
            return samples.encode(), samples.notes, {}
        result = fit(samples, FitOptions())
        found, sentences = result.model, result.report.warnings
        about = {"error_of_the_fit": result.report.metrics.relative_rms}
    elif len(sources) > 1 or suffix == ".csv":
        raise InvalidArgumentError("only tables of samples can be joined, or written as .csv")
    else:
        options.refuse("a measurement on a grid")
        found = read_rgl(source) if kind == "rgl" else read_merl(source)
    if isinstance(found, RglMaterial) and suffix == ".bsdf" and not spectral:
        return source.read_bytes(), (), {}
    if suffix == ".bsdf":
        return rgl_bsdf(found, source.stem, spectral=spectral), sentences, about
    if isinstance(found, RglMaterial):  # A MERL table loses the difference between both orders of the two directions.
        difference = found.non_reciprocity()
        about = {"non_reciprocity": difference}
        if difference > _MAX_RECIPROCITY_ERROR:
            sentences = (
                f"with the two directions swapped, values differ by {difference:.0%} in the median. A MERL table has "
                "one value for both, their mean: pictures will look different.",
            )
        found = found.measurement()
    return encode_merl(found if isinstance(found, Measurement) else found.tabulate()), sentences, about
