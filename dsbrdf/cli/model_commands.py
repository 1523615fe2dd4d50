"""Commands that read a model, ``dsbrdf eval``, ``show``, ``decompose``, ``export``, or a measurement: ``convert``."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from dsbrdf.cli.arguments import print_json, print_written
from dsbrdf.cli.parameters import Component, Json, ModelFile, OutputFile, Points, direction
from dsbrdf.cli.source_files import named_part, read_model
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.grid import CHANNELS
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.export import FORMATS, export_model
from dsbrdf.output.export.export_file import format_of
from dsbrdf.output.report_text import component_documents, lobes_phrase, model_text, result_document, result_text
from dsbrdf.output.serialize import save

Channel = Annotated[str, Parameter(choices=CHANNELS)]
GuideFile = Annotated[Path | None, Parameter(alias="-o", metavar="FILE")]
_FORMAT_HELP = "; ".join(f"{name}: {kind.purpose}" for name, kind in FORMATS.items())
Format = Annotated[
    str | None,
    Parameter(
        name="--format",
        metavar="FORMAT",
        choices=tuple(FORMATS),
        show_choices=False,
        help=f"By default that of the file's suffix. {_FORMAT_HELP}. All hold the guide, those of values a component.",
    ),
]

_NO_POINTS = Points()


def evaluate(
    model: ModelFile, /, *, points: Points = _NO_POINTS, component: Component = None, json: Json = False
) -> int:
    """Print values of a model or of one of its components; return the exit code."""
    part = named_part(model, read_model(model)[0], component)
    columns = points.arrays()
    if "theta_in_deg" in columns:
        theta_in, theta_out, phi_out = columns.values()
        values = part.evaluate_directions(direction(theta_in, 0.0), direction(theta_out, phi_out))
    elif "omega_in" in columns:
        values = part.evaluate_directions(columns["omega_in"], columns["omega_out"])
    else:
        values = part.evaluate(*(np.radians(angles) for angles in columns.values()))
    if json:
        print_json({name: array.tolist() for name, array in columns.items()} | {"values": values.tolist()})
        return 0
    rows = [
        [",".join(f"{number:.6g}" for number in np.ravel(part)) for part in point]
        for point in zip(*columns.values(), strict=True)
    ]
    heads = [name.removesuffix("_deg") for name in columns]
    widths = [max(map(len, column)) + 2 for column in zip(heads, *rows, strict=True)]
    widths[0] -= 2
    number = 12 if sum(widths) + 36 <= shutil.get_terminal_size().columns else 9  # of a value; exact ones are in JSON
    print(_aligned(heads, widths) + "".join(f"{channel:>{number}}" for channel in CHANNELS))
    for row, value in zip(rows, values, strict=True):
        print(_aligned(row, widths) + "".join(f"{one:>{number}.{6 if number == 12 else 3}g}" for one in value))
    return 0


def _aligned(cells: Sequence[str], widths: Sequence[int]) -> str:
    return "".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))


def show(model: ModelFile, /, *, lobes: bool = False, channel: Channel = "red", json: Json = False) -> int:
    """Print the report of a fit again; return the exit code.

    Parameters
    ----------
    lobes
        Print the lobes of the model too, not only those of its components.
    channel
        Of the model's lobes in the text.
    """
    stored, report = read_model(model)
    if json:
        print_json(result_document(stored, report))
    elif report is None:
        print(f"{model.stem}: {lobes_phrase(stored)}", "", *model_text(stored, lobes=lobes, channel=channel), sep="\n")
    else:
        print(*result_text(model, FitResult(stored, report), lobes=lobes, channel=channel), sep="\n")
    return 0


def print_components(model: ModelFile, /, *, output: GuideFile = None, json: Json = False) -> int:
    """Print the components of a model and their own lobes; return the exit code.

    Parameters
    ----------
    output
        Save the guide, which is the components' own lobes together, as a model: .json or .npz.
    """
    stored, _ = read_model(model)
    if output is not None:
        save(decompose(stored).guide, output)
        if not json:
            print_written(output, "the guide, the components' own lobes together")
    if json:
        print_json({"items": component_documents(stored)})
    else:
        print(*model_text(stored), sep="\n")
    return 0


def export(
    model: ModelFile,
    /,
    *,
    file_format: Format = None,
    output: OutputFile,
    component: Component = None,
    json: Json = False,
) -> int:
    """Write a model, or one of its components, for other programs; return the exit code.

    Parameters
    ----------
    output
        The file to write.
    """
    name = file_format or format_of(output)
    stored, report = read_model(model)
    content = export_model(named_part(model, stored, component), name, report if component is None else None)
    write_atomically(output, [content])
    if json:
        print_json({"output": str(output), "format": name, "bytes": len(content)})
    else:
        of = "" if component is None else f" of the {component.replace('_', ' ')}"
        print_written(output, f"{FORMATS[name].purpose.partition(',')[0]}{of}")
    return 0
