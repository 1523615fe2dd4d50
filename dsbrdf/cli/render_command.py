"""The command ``dsbrdf render``: lit spheres of models and measurements as a PNG file."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.cli.arguments import add_json_option, number, print_json, whole_number
from dsbrdf.cli.source_files import named_in_errors, read_source
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.decomposition import LABELS, decompose
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.environment import EnvironmentMap, read_environment
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import LIGHTINGS, render_sphere, sphere_normals
from dsbrdf.output.png import encode_png
from dsbrdf.output.sphere_panels import compare_spheres, side_by_side

Array = NDArray[np.float64]

_PICTURES = (".hdr", ".exr")


def configure(parser: argparse.ArgumentParser, _: str) -> None:
    """Add the arguments of the command to its parser."""
    parser.set_defaults(run=_render)
    parser.add_argument(
        "sources",
        nargs="+",
        type=Path,
        metavar="SOURCE",
        help="a .json or .npz model, or a .binary or .bsdf measurement; a second one, a model, is compared with the "
        "first: the picture then shows both, their difference and the components of the model",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.png", help="the file to write")
    parser.add_argument(
        "--lighting",
        type=_lighting,
        default=LIGHTINGS[0],
        metavar="|".join((*LIGHTINGS, "FILE")),
        help="default: %(default)s; FILE is a panorama of 360 by 180 degrees, .hdr or .exr",
    )
    parser.add_argument("--size", type=whole_number, default=256, metavar="PIXELS", help="default: %(default)s")
    parser.add_argument("--component", choices=LABELS, help="one component instead of the whole model")
    parser.add_argument(
        "--exposure",
        type=number,
        metavar="FACTOR",
        help="what radiance is multiplied by before it is clipped at 1 and gets the sRGB curve; "
        "by default the 99th percentile of the whole material, or of the first source, becomes 1",
    )
    add_json_option(parser)


def _lighting(text: str) -> str:
    """Argument type: the name of a lighting or of a picture."""
    if text in LIGHTINGS or text.lower().endswith(_PICTURES):
        return text
    raise argparse.ArgumentTypeError(f"must be {', '.join(LIGHTINGS)} or a .hdr or .exr file, not {text!r}")


def _render(arguments: argparse.Namespace) -> int:
    if arguments.output.suffix.lower() != ".png":
        raise InvalidArgumentError(f"{arguments.output}: the picture's file must end in .png")
    factor = arguments.exposure
    if factor is not None and not 0.0 < factor < float("inf"):
        raise InvalidArgumentError(f"the exposure must be a positive number, not {factor:g}")
    if len(arguments.sources) > 2:
        raise InvalidArgumentError(f"one or two sources can be drawn, not {len(arguments.sources)}")
    lighting: str | EnvironmentMap = arguments.lighting
    if arguments.lighting not in LIGHTINGS:
        with named_in_errors(Path(arguments.lighting)):
            lighting = read_environment(arguments.lighting)
    draw = _sphere if len(arguments.sources) == 1 else _comparison
    image, about = draw(arguments, lighting)
    write_atomically(arguments.output, [encode_png(image)])
    if arguments.json:
        print_json({"output": str(arguments.output), "lighting": arguments.lighting} | about)
        return 0
    print(f"{arguments.output}: {arguments.lighting}, radiance times {about['exposure']:.4g}, clipped at 1, sRGB curve")
    if "panels" in about:
        print(f"from left to right: {', '.join(about['panels'])}")
        psnr = "infinite" if about["psnr"] is None else f"{about['psnr']:.1f} dB"
        print(f"likeness of the fit: PSNR {psnr}, SSIM {about['ssim']:.4f}")
    return 0


def _sphere(arguments: argparse.Namespace, lighting: str | EnvironmentMap) -> tuple[Array, dict[str, Any]]:
    """Picture of one source, or of one of its components, and what to report."""
    whole, factor = read_source(arguments.sources[0]), arguments.exposure
    source = whole
    if arguments.component is not None:
        if isinstance(whole, Measurement):
            raise InvalidArgumentError(f"{arguments.sources[0]}: a measurement has no components; fit it first")
        source = decompose(whole)[arguments.component].model
    image = render_sphere(source, lighting=lighting, size=arguments.size)
    if factor is None:
        of_whole = image if source is whole else render_sphere(whole, lighting=lighting, size=arguments.size)
        factor = exposure(of_whole, sphere_normals(arguments.size)[1])
    return displayed(image, factor), {"exposure": factor}


def _comparison(arguments: argparse.Namespace, lighting: str | EnvironmentMap) -> tuple[Array, dict[str, Any]]:
    """Panels of two sources, and what to report."""
    if arguments.component is not None:
        raise InvalidArgumentError("a comparison shows all components: leave --component out")
    measured, fit = (read_source(path) for path in arguments.sources)
    if not isinstance(fit, DSBRDF):
        raise InvalidArgumentError(f"{arguments.sources[1]}: the second source must be a model, the fit of the first")
    found = compare_spheres(measured, fit, lighting=lighting, size=arguments.size, factor=arguments.exposure)
    psnr = found.psnr if np.isfinite(found.psnr) else None
    about = {"exposure": found.exposure, "panels": list(found.panels), "psnr": psnr, "ssim": found.ssim}
    return side_by_side(found.panels), about
