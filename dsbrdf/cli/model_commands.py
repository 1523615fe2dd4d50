"""Commands that read a model, ``dsbrdf eval``, ``show``, ``decompose``, ``export``, or a measurement: ``convert``."""

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.parameters import Component, Json, ModelFile, OutputFile, Points
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
    if "omega_in" in columns:
        values = part.evaluate_directions(columns["omega_in"], columns["omega_out"])
    else:
        values = part.evaluate(*(np.radians(angles) for angles in columns.values()))
    if json:
        print_json({name: array.tolist() for name, array in columns.items()} | {"values": values.tolist()})
        return 0
    print("".join(f"{name:>24}" for name in columns) + "".join(f"{channel:>14}" for channel in CHANNELS))
    for *point, value in zip(*columns.values(), values, strict=True):
        left = "".join(f"{','.join(f'{number:.6g}' for number in np.ravel(part)):>24}" for part in point)
        print(left + "".join(f"{number:>14.6g}" for number in value))
    return 0


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
    return 0
