"""Commands that read a stored model: ``dsbrdf eval``, ``show``, ``decompose`` and ``export``."""

import argparse
from pathlib import Path

import numpy as np

from dsbrdf.cli.arguments import add_json_option, print_json
from dsbrdf.cli.point_arguments import add_point_options, given_points
from dsbrdf.cli.source_files import read_model
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.grid import CHANNELS
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.decomposition import LABELS, decompose
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import FORMATS, export_model
from dsbrdf.output.report_text import component_documents, lobes_phrase, model_text, result_document, result_text


def configure(parser: argparse.ArgumentParser, command: str) -> None:
    """Add the arguments of one of the commands to its parser."""
    {
        "eval": _configure_eval,
        "show": _configure_show,
        "decompose": _configure_decompose,
        "export": _configure_export,
    }[command](parser)
    parser.add_argument("model", type=Path, metavar="MODEL", help="a .json or .npz file from dsbrdf fit")
    add_json_option(parser)
    if command in ("eval", "export"):
        parser.add_argument("--component", choices=LABELS, help="one component instead of the whole model")


def _configure_eval(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=_eval)
    add_point_options(parser)


def _configure_show(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=_show)


def _configure_decompose(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=_decompose)
    parser.add_argument("--channel", choices=CHANNELS, default="red", help="channel of the parameters in the text")


def _configure_export(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=_export)
    parser.add_argument(
        "--format", choices=FORMATS, help="by default that of OUT's suffix; merl is a .binary file, a table of values"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT", help="the file to write")


def _eval(arguments: argparse.Namespace) -> int:
    model = _component(read_model(arguments.model)[0], arguments.component)
    points = given_points(arguments)
    if "omega_in" in points:
        values = model.evaluate_directions(points["omega_in"], points["omega_out"])
    else:
        values = model.evaluate(*(np.radians(angles) for angles in points.values()))
    if arguments.json:
        print_json({name: array.tolist() for name, array in points.items()} | {"values": values.tolist()})
        return 0
    print("".join(f"{name:>24}" for name in points) + "".join(f"{channel:>14}" for channel in CHANNELS))
    for *point, value in zip(*points.values(), values, strict=True):
        left = "".join(f"{','.join(f'{number:.6g}' for number in np.ravel(part)):>24}" for part in point)
        print(left + "".join(f"{number:>14.6g}" for number in value))
    return 0


def _show(arguments: argparse.Namespace) -> int:
    model, report = read_model(arguments.model)
    if arguments.json:
        print_json(result_document(model, report))
    elif report is None:
        print(f"{arguments.model.stem}: {lobes_phrase(model)}", "", *model_text(model), sep="\n")
    else:
        print(*result_text(arguments.model, FitResult(model, report)), sep="\n")
    return 0


def _decompose(arguments: argparse.Namespace) -> int:
    model, _ = read_model(arguments.model)
    if arguments.json:
        print_json({"items": component_documents(model)})
    else:
        print(*model_text(model, channel=arguments.channel), sep="\n")
    return 0


def _export(arguments: argparse.Namespace) -> int:
    file_format = arguments.format or _format_of(arguments.output)
    model, report = read_model(arguments.model)
    whole = arguments.component is None
    content = export_model(_component(model, arguments.component), file_format, report if whole else None)
    write_atomically(arguments.output, [content])
    if arguments.json:
        print_json({"output": str(arguments.output), "format": file_format, "bytes": len(content)})
    return 0


def _format_of(path: Path) -> str:
    suffix = path.suffix.lower().removeprefix(".")
    for name, file_format in FORMATS.items():
        if file_format.suffix == suffix:
            return name
    known = ", ".join(dict.fromkeys(f".{file_format.suffix}" for file_format in FORMATS.values()))
    raise InvalidArgumentError(f"{path}: the file must end in one of {known}, or --format must name its format")


def _component(model: DSBRDF, label: str | None) -> DSBRDF:
    return model if label is None else decompose(model)[label].model
