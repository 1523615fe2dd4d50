"""The command ``dsbrdf render``: a lit sphere of a model or a measurement as a PNG file."""

import argparse
from pathlib import Path

from dsbrdf.cli.arguments import add_json_option, print_json, whole_number
from dsbrdf.cli.source_files import read_source
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.decomposition import LABELS, decompose
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import LIGHTINGS, render_sphere, sphere_normals
from dsbrdf.output.png import encode_png


def configure(parser: argparse.ArgumentParser, _: str) -> None:
    """Add the arguments of the command to its parser."""
    parser.set_defaults(run=_render)
    parser.add_argument("source", type=Path, metavar="SOURCE", help="a .json or .npz model, or a MERL .binary file")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.png", help="the file to write")
    parser.add_argument("--lighting", choices=LIGHTINGS, default=LIGHTINGS[0], help="default: %(default)s")
    parser.add_argument("--size", type=whole_number, default=256, metavar="PIXELS", help="default: %(default)s")
    parser.add_argument("--component", choices=LABELS, help="one component instead of the whole model")
    parser.add_argument(
        "--exposure",
        type=float,
        metavar="FACTOR",
        help="what radiance is multiplied by before the sRGB curve; "
        "by default the whole material's 99th percentile becomes white",
    )
    add_json_option(parser)


def _render(arguments: argparse.Namespace) -> int:
    if arguments.output.suffix.lower() != ".png":
        raise InvalidArgumentError(f"{arguments.output}: the picture's file must end in .png")
    factor = arguments.exposure
    if factor is not None and not 0.0 < factor < float("inf"):
        raise InvalidArgumentError(f"the exposure must be a positive number, not {factor:g}")
    whole = read_source(arguments.source)
    source = whole
    if arguments.component is not None:
        if isinstance(whole, Measurement):
            raise InvalidArgumentError(f"{arguments.source}: a measurement has no components; fit it first")
        source = decompose(whole)[arguments.component].model
    image = render_sphere(source, lighting=arguments.lighting, size=arguments.size)
    if factor is None:
        of_whole = image if source is whole else render_sphere(whole, lighting=arguments.lighting, size=arguments.size)
        factor = exposure(of_whole, sphere_normals(arguments.size)[1])
    write_atomically(arguments.output, [encode_png(displayed(image, factor))])
    if arguments.json:
        print_json({"output": str(arguments.output), "lighting": arguments.lighting, "exposure": factor})
    else:
        print(f"{arguments.output}: {arguments.lighting}, radiance times {factor:.4g}, sRGB")
    return 0
