"""The command ``dsbrdf plot``: figures of a stored model."""

import argparse
from pathlib import Path

from dsbrdf.cli.arguments import add_json_option, print_json
from dsbrdf.cli.source_files import read_grid, read_model
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.reduction import profiles
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.output.figures import IMAGE_FORMATS, encode_figure, overview_figure
from dsbrdf.output.parameters_figure import parameters_figure


def configure(parser: argparse.ArgumentParser, _: str) -> None:
    """Add the arguments of the command to its parser."""
    parser.set_defaults(run=_plot)
    parser.add_argument("model", type=Path, metavar="MODEL", help="a .json or .npz file from dsbrdf fit")
    parser.add_argument(
        "measurement",
        type=Path,
        nargs="?",
        metavar="MEASUREMENT",
        help="what was fitted: draws its profiles, the fit and the lobes; without it, the parameters over theta_diff",
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="OUT", help=f"the file to write: {', '.join(IMAGE_FORMATS)}"
    )
    add_json_option(parser)


def _plot(arguments: argparse.Namespace) -> int:
    image_format = arguments.output.suffix.lower().removeprefix(".")
    if image_format not in IMAGE_FORMATS:
        raise InvalidArgumentError(f"{arguments.output}: the figure's file must end in {_endings()}")
    model, _ = read_model(arguments.model)
    if arguments.measurement is None:
        figure = parameters_figure(model, title=arguments.model.stem)
    else:
        figure = overview_figure(profiles(read_grid(arguments.measurement)), model)
    content = encode_figure(figure, image_format)
    write_atomically(arguments.output, [content])
    if arguments.json:
        print_json({"output": str(arguments.output), "format": image_format, "bytes": len(content)})
    return 0


def _endings() -> str:
    *others, last = (f".{name}" for name in IMAGE_FORMATS)
    return f"{', '.join(others)} or {last}"
