"""The command ``dsbrdf compare``: two models or measurements beside each other."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from dsbrdf.cli.arguments import add_json_option, print_json
from dsbrdf.cli.source_files import MEASUREMENTS, read_grid, read_model
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.metrics import METRICS
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import render_sphere, sphere_likeness, sphere_normals
from dsbrdf.output.png import encode_png
from dsbrdf.output.report_text import lobes_phrase
from dsbrdf.output.sphere_panels import DIFFERENCE_GAIN, side_by_side

_SIZE = 256  # pixels of a sphere


def configure(parser: argparse.ArgumentParser, _: str) -> None:
    """Add the arguments of the command to its parser."""
    parser.set_defaults(run=_compare)
    for name in ("first", "second"):
        parser.add_argument(
            name, type=Path, metavar=name.upper(), help="a .json or .npz model, or a .binary or .bsdf measurement"
        )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="OUT.png",
        help="write a picture: both spheres with the exposure of the first, and their difference",
    )
    add_json_option(parser)


def _compare(arguments: argparse.Namespace) -> int:
    if arguments.output is not None and arguments.output.suffix.lower() != ".png":
        raise InvalidArgumentError(f"{arguments.output}: the picture's file must end in .png")
    paths = (arguments.first, arguments.second)
    sources, columns = zip(*(_source(path) for path in paths), strict=True)
    first, second = (render_sphere(source, size=_SIZE) for source in sources)
    psnr, ssim = sphere_likeness(first, second)
    if arguments.output is not None:
        factor = exposure(first, sphere_normals(_SIZE)[1])
        panels = {"first": displayed(first, factor), "second": displayed(second, factor)}
        panels["difference"] = np.clip(DIFFERENCE_GAIN * np.abs(panels["first"] - panels["second"]), 0.0, 1.0)
        write_atomically(arguments.output, [encode_png(side_by_side(panels))])
    if arguments.json:
        likeness = {"psnr": psnr if np.isfinite(psnr) else None, "ssim": ssim}
        items = [{"file": str(path)} | column for path, column in zip(paths, columns, strict=True)]
        output = None if arguments.output is None else str(arguments.output)
        print_json({"items": items, "likeness": likeness, "output": output})
        return 0
    print(f"{'':<18}" + "".join(f"{path.name:>26}" for path in paths))
    for name in columns[0]:
        print(f"{name:<18}" + "".join(f"{_cell(column[name]):>26}" for column in columns))
    print(f"likeness of their lit spheres: PSNR {psnr:.1f} dB, SSIM {ssim:.4f}")
    if arguments.output is not None:
        print(f"{arguments.output}: both spheres, and their difference times {DIFFERENCE_GAIN:g}")
    return 0


def _source(path: Path) -> tuple[Any, dict[str, Any]]:
    """Read a model or a measurement, and return it with what is known of it."""
    if path.suffix.lower() in MEASUREMENTS:
        return read_grid(path), {"kind": "measurement", "numbers": None} | dict.fromkeys(METRICS)
    model, report = read_model(path)
    metrics = {name: None if report is None else report.metrics[name] for name in METRICS}
    return model, {"kind": lobes_phrase(model), "numbers": model.n_numbers} | metrics


def _cell(value: str | float | None) -> str:
    return "" if value is None else value if isinstance(value, str) else f"{value:.4g}"
