"""Accuracy and time of the fit on every material of a folder.

The folder is the one that ``DSBRDF_REFERENCE_DATA`` names; without it three synthetic materials are fitted.
"""

import argparse
import json
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cyclopts import App

from dsbrdf import ConvergenceWarning, DSBRDFError, FitOptions, Measurement, fit, read_merl
from dsbrdf.cli.parameters import DEFAULT, Flags
from dsbrdf.data import synthetic_measurement
from dsbrdf.fitting import METRICS

FIGURES = (*METRICS, "numbers", "seconds")
DIGITS = {"psnr": 1, "numbers": 0, "seconds": 2}
"""Decimal places of the figures that do not have 4."""
WIDTH = 16
QUANTILES = {"min": 0.0, "median": 0.5, "p90": 0.9, "max": 1.0}


@dataclass(frozen=True)
class Row:
    """Outcome of one material: its `FIGURES`, and how many lobes there are about the normal and on rings."""

    name: str
    figures: dict[str, float | None]
    n_lobes: int
    ring_lobes: int


Source = tuple[str, Callable[[], Measurement]]
"""Name of a material, and the function that reads it."""


def sources(arguments: argparse.Namespace) -> Iterator[Source]:
    """Yield the selected materials of the folder, or of the synthetic ones if there is none."""
    every: list[Source]
    if folder := os.environ.get("DSBRDF_REFERENCE_DATA"):
        every = [(path.stem, partial(read_merl, path)) for path in sorted(Path(folder).glob("*.binary"))]
    else:
        makers = {f"synthetic_{r:g}": partial(synthetic_measurement, roughness=r, noise=0.02) for r in (0.02, 0.1, 0.5)}
        every = [(name, partial(make, name=name)) for name, make in makers.items()]
    chosen = [source for source in every if any(word in source[0] for word in arguments.names.split(","))]
    if not chosen:
        raise SystemExit(f"no material has one of {arguments.names} in its name")
    yield from chosen[:: arguments.every]


def measured(name: str, material: Measurement, options: FitOptions) -> Row:
    """Fit one material."""
    start = time.perf_counter()
    result = fit(material, options)
    seconds = time.perf_counter() - start
    model, metrics = result.model, asdict(result.report.metrics)
    figures = {metric: metrics[metric] for metric in METRICS}
    rings = int(np.count_nonzero(model.is_ring))
    return Row(name, figures | {"numbers": model.n_numbers, "seconds": seconds}, model.n_lobes - rings, rings)


def summary(rows: Sequence[Row]) -> dict[str, dict[str, dict[str, float]]]:
    """Return the spread of every figure for each database, the first word of a name, and for all."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.name.split("_")[0], []).append(row)
    if len(groups) > 1:
        groups["all"] = list(rows)
    return {group: {figure: _spread(members, figure) for figure in FIGURES} for group, members in groups.items()}


def _spread(rows: Sequence[Row], figure: str) -> dict[str, float]:
    values = [value for row in rows if (value := row.figures[figure]) is not None]
    return {name: float(np.quantile(values, share)) if values else float("nan") for name, share in QUANTILES.items()}


def print_row(name: str, figures: Mapping[str, float | None], lobes: str = "") -> None:
    """Print one line of the table."""
    cells = [f"{name:34}"]
    for figure in FIGURES:
        value = figures[figure]
        cells.append("-".rjust(WIDTH) if value is None else f"{value:{WIDTH}.{DIGITS.get(figure, 4)}f}")
    print("".join(cells) + f"{lobes:>7}", flush=True)


def print_summary(rows: Sequence[Row]) -> None:
    """Print the spread of each database and of all materials."""
    for group, figures in summary(rows).items():
        count = len(rows) if group == "all" else sum(row.name.split("_")[0] == group for row in rows)
        for share in QUANTILES:
            spread = {figure: shares[share] for figure, shares in figures.items()}
            print_row(f"{share} of {group} ({count})", spread)


def _options(*, flags: Flags = DEFAULT) -> FitOptions:
    return flags.options()


def main(argv: Sequence[str]) -> int:
    """Print the table, or the same as JSON; the exit code is 1 if a fit failed."""
    options_help = "The options of the fit are those of dsbrdf fit --help."
    parser = argparse.ArgumentParser(prog="python -m benchmarks materials", description=__doc__, epilog=options_help)
    parser.add_argument("--names", default="", help="only materials whose name contains one of these, with commas")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every N-th of them (default: 1)")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of the table")
    arguments, words = parser.parse_known_args(argv)
    options: FitOptions = App(default_command=_options, result_action="return_value")(words)
    rows, failures = [], []
    if not arguments.json:
        print(f"{'':34}{''.join(f'{figure:>{WIDTH}}' for figure in FIGURES)}{'lobes':>7}")
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        for name, get in sources(arguments):
            try:
                row = measured(name, get(), options)
            except DSBRDFError as error:
                failures.append(name)
                print(f"{name}: {error}", file=sys.stderr)
                continue
            rows.append(row)
            if not arguments.json:
                print_row(name, row.figures, f"{row.n_lobes}+{row.ring_lobes}")
    document: dict[str, Any] = {"options": asdict(options), "rows": [asdict(row) for row in rows]}
    if arguments.json:
        print(json.dumps(document | {"summary": summary(rows), "failed": failures}, indent=1))
    else:
        print_summary(rows)
    return 1 if failures else 0
