"""The command ``dsbrdf compare``: two models or measurements beside each other."""

from pathlib import Path
from typing import Any

import numpy as np

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.parameters import Json, OutputFile, SourceFile
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


def compare(first: SourceFile, second: SourceFile, /, *, output: OutputFile | None = None, json: Json = False) -> int:
    """Compare two models or measurements; return the exit code.

    Parameters
    ----------
    output
        Write a picture, a .png file: both spheres with the exposure of the first, and their difference.
    """
    if output is not None and output.suffix.lower() != ".png":
        raise InvalidArgumentError(f"{output}: the picture's file must end in .png")
    paths = (first, second)
    sources, columns = zip(*(_source(path) for path in paths), strict=True)
    spheres = [render_sphere(source, size=_SIZE) for source in sources]
    psnr, ssim = sphere_likeness(*spheres)
    if output is not None:
        factor = exposure(spheres[0], sphere_normals(_SIZE)[1])
        panels = {name: displayed(sphere, factor) for name, sphere in zip(("first", "second"), spheres, strict=True)}
        panels["difference"] = np.clip(DIFFERENCE_GAIN * np.abs(panels["first"] - panels["second"]), 0.0, 1.0)
        write_atomically(output, [encode_png(side_by_side(panels))])
    if json:
        likeness = {"psnr": psnr if np.isfinite(psnr) else None, "ssim": ssim}
        items = [{"file": str(path)} | column for path, column in zip(paths, columns, strict=True)]
        print_json({"items": items, "likeness": likeness, "output": None if output is None else str(output)})
        return 0
    print(f"{'':<18}" + "".join(f"{path.name:>26}" for path in paths))
    for name in columns[0]:
        print(f"{name:<18}" + "".join(f"{_cell(column[name]):>26}" for column in columns))
    print(f"likeness of their lit spheres: PSNR {psnr:.1f} dB, SSIM {ssim:.4f}")
    if output is not None:
        print(f"{output}: both spheres, and their difference times {DIFFERENCE_GAIN:g}")
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
