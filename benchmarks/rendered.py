"""Lit spheres of each material: how close to the measurement the fit looks, and what else looks as close.

PSNR and SSIM against the sphere of the measurement, under both lightings of `dsbrdf.render_sphere`, of

- the default fit,
- a Lambertian ground and two GGX highlights, fitted by what a lit sphere shows, see `dsbrdf.output.comparison`,
- the table of means over phi_diff, with as many rows and columns as the measurement, interpolated alike,
- another program's description of the material, where there is ``peer_<material>.binary``.

With ``--sheet`` a picture shows measured and fitted spheres, their difference and the components.
"""

import argparse
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.material_filter import REFERENCE_VARIABLE, add_arguments, chosen_measurements
from dsbrdf import DSBRDF, ConvergenceWarning, Measurement, fit, profiles, read_merl, render_sphere
from dsbrdf.arrays import Array
from dsbrdf.data import GRID_SHAPE, nodes_above_horizon
from dsbrdf.output.comparison import fit_ggx
from dsbrdf.output.sphere_panels import compare_spheres
from dsbrdf.rendering import LIGHTINGS, sphere_likeness

FIT = "fit"
GGX = "2 GGX"
TABLE = "phi means"
PEER = "peer"
WAYS = (FIT, GGX, TABLE, PEER)
WIDTH = 16
SHEET_SIZE = 160
_WITHOUT_COMPONENTS = 3  # measured, fit, difference


@dataclass(frozen=True)
class Likeness:
    """PSNR [dB] and SSIM of one way under each of `LIGHTINGS`."""

    psnr: tuple[float, ...]
    ssim: tuple[float, ...]


def phi_means(measurement: Measurement) -> Measurement:
    """Table of the means over phi_diff, all samples above the horizon taken."""
    summary = profiles(measurement, horizon_cutoff=None)
    means = np.broadcast_to(summary.mean.swapaxes(1, 2)[..., np.newaxis], (3, *GRID_SHAPE))
    known = np.all(summary.weight > 0, axis=0).T[..., np.newaxis] & nodes_above_horizon()
    return Measurement.from_values(means, known, measurement.name)


def compare(measurement: Measurement, model: DSBRDF, peers: Path | None, size: int) -> dict[str, Likeness]:
    """Likeness of each way to the measurement."""
    references = [render_sphere(measurement, lighting=lighting, size=size) for lighting in LIGHTINGS]

    def likeness(source: Measurement | Callable[[Array, Array, Array], Array]) -> Likeness:
        images = [render_sphere(source, lighting=lighting, size=size) for lighting in LIGHTINGS]
        pairs = [sphere_likeness(*both) for both in zip(references, images, strict=True)]
        return Likeness(*zip(*pairs, strict=True))

    found = {
        FIT: likeness(model.evaluate),
        GGX: likeness(fit_ggx(measurement.interpolated.evaluate).evaluate),
        TABLE: likeness(phi_means(measurement)),
    }
    if peers and (path := peers / f"peer_{measurement.name}.binary").exists():
        found[PEER] = likeness(read_merl(path))
    return found


def print_table(results: dict[str, dict[str, Likeness]]) -> None:
    """Print medians of each data base, and on how many materials the fit beats each other way."""
    groups: dict[str, list[dict[str, Likeness]]] = {}
    for name, found in results.items():
        groups.setdefault(name.split("_")[0], []).append(found)
    for group, rows in groups.items():
        print_row(f"median of {group} ({len(rows)})", {way: _median(rows, way) for way in WAYS})
    for group, rows in groups.items():
        for way in WAYS[1:]:
            pairs = [(row[FIT], row[way]) for row in rows if way in row]
            for i, lighting in enumerate(LIGHTINGS if pairs else ()):
                psnr = sum(ours.psnr[i] > theirs.psnr[i] for ours, theirs in pairs)
                ssim = sum(ours.ssim[i] > theirs.ssim[i] for ours, theirs in pairs)
                print(f"{group}, {lighting}: above {way} in PSNR on {psnr} of {len(pairs)}, in SSIM on {ssim}")


def print_row(name: str, found: dict[str, Likeness | None]) -> None:
    """Print one line: under each lighting PSNR, then SSIM, a column for each way."""
    cells = [name.ljust(34)]
    for figure, digits in (("psnr", 1), ("ssim", 3)):
        for way in WAYS:
            one = found.get(way)
            values = getattr(one, figure) if one else ()
            cells.append(" / ".join(f"{value:.{digits}f}" for value in values).rjust(WIDTH) or " " * WIDTH)
    print("".join(cells), flush=True)


def _median(rows: Sequence[dict[str, Likeness]], way: str) -> Likeness | None:
    present = [row[way] for row in rows if way in row]
    if not present:
        return None
    figures = [np.median([getattr(one, figure) for one in present], axis=0) for figure in ("psnr", "ssim")]
    return Likeness(*(tuple(values.tolist()) for values in figures))


def strip(measurement: Measurement, model: DSBRDF) -> dict[str, Array]:
    """Return the pictures in one material's row of the contact sheet by title, as a screen shows them."""
    pictures: dict[str, Array] = {}
    for lighting in LIGHTINGS:
        panels = compare_spheres(measurement, model, lighting=lighting, size=SHEET_SIZE).panels
        shown = panels if lighting == LIGHTINGS[0] else dict(list(panels.items())[:_WITHOUT_COMPONENTS])
        pictures |= {f"{title}\n{lighting}": picture for title, picture in shown.items()}
    return pictures


def save_sheet(path: Path, strips: dict[str, dict[str, Array]]) -> None:
    """Write one picture of all materials, a row for each."""
    from matplotlib.figure import Figure

    titles = list(next(iter(strips.values())))
    inches = SHEET_SIZE / 100
    figure = Figure(figsize=(inches * len(titles) + 0.4, inches * len(strips) + 0.6), facecolor="black")
    axes = figure.subplots(len(strips), len(titles), squeeze=False)
    for row, (name, pictures) in zip(axes, strips.items(), strict=True):
        for axis, picture in zip(row, pictures.values(), strict=True):
            axis.imshow(picture, interpolation="none")
            axis.set_xticks([])
            axis.set_yticks([])
        row[0].set_ylabel(name, color="white", fontsize=7)
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, color="white", fontsize=8)
    figure.tight_layout(pad=0.3)
    figure.savefig(path, dpi=100)


def main(argv: Sequence[str]) -> int:
    """Print the table, and write the sheet if one is asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks rendered", description=__doc__)
    add_arguments(parser, every=1)
    parser.add_argument("--peers", type=Path, help="folder of peer_<material>.binary (default: that of the materials)")
    parser.add_argument("--size", type=int, default=128, help="pixels along a side (default: 128)")
    parser.add_argument("--sheet", type=Path, metavar="PNG", help="write a picture of the materials there")
    arguments = parser.parse_args(argv)
    beside = os.environ.get(REFERENCE_VARIABLE)
    peers = arguments.peers or (Path(beside) if beside else None)
    print(f"{'PSNR, then SSIM: ' + ' / '.join(LIGHTINGS):34}")
    print(" " * 34 + "".join(way.rjust(WIDTH) for way in WAYS * 2))
    results: dict[str, dict[str, Likeness]] = {}
    strips: dict[str, dict[str, Array]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for measurement in chosen_measurements(arguments):
            if measurement.name.startswith("peer_"):
                continue
            model = fit(measurement).model
            results[measurement.name] = compare(measurement, model, peers, arguments.size)
            print_row(measurement.name, dict(results[measurement.name]))
            if arguments.sheet:
                strips[measurement.name] = strip(measurement, model)
    print_table(results)
    if arguments.sheet:
        save_sheet(arguments.sheet, strips)
    return 0
