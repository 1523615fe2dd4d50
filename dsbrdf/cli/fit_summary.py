"""The fits of several files as a table, in the terminal and as CSV."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from dsbrdf.engines.batch import FileFit
from dsbrdf.fitting.metrics import METRICS
from dsbrdf.output.report_text import lobes_phrase

SHOWN = ("relative_rms", "excess", "albedo_error", "psnr")
"""Metrics in the table of the terminal; the CSV has all."""

_COLUMNS = ("file", "status", "error", "n_lobes", "ring_lobes", *METRICS, "seconds", "output", "warnings")


def summary_table(items: Sequence[FileFit]) -> list[str]:
    """Return a table with a line for each fit, the largest ``relative_rms`` first, and how many files failed."""
    fits = sorted((item for item in items if item.result is not None), key=_relative_rms, reverse=True)
    width = max([len(item.file.stem) for item in fits] + [len("worst first")])
    heads = "".join(f"{name:>14}" for name in SHOWN)
    lines = [f"{'worst first':<{width}}  {'lobes':<24}{heads}{'warnings':>10}"]
    for item in fits:
        if item.result is not None:
            metrics, warnings = item.result.report.metrics, len(item.result.report.warnings)
            cells = "".join(f"{'' if metrics[name] is None else f'{metrics[name]:.4g}':>14}" for name in SHOWN)
            lines.append(f"{item.file.stem:<{width}}  {lobes_phrase(item.result.model):<24}{cells}{warnings:>10}")
    failed = len(items) - len(fits)
    if failed:
        lines.append(f"{failed} {'file' if failed == 1 else 'files'} could not be fitted")
    return lines


def summary_csv(items: Sequence[FileFit]) -> bytes:
    """Return a table as CSV with a line for each file, in their order."""
    text = io.StringIO()
    table = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(_row(item) for item in items)
    return text.getvalue().encode()


def _row(item: FileFit) -> dict[str, Any]:
    if item.result is None:
        return {"file": item.file, "status": "failed", "error": item.error}
    model, report = item.result.model, item.result.report
    rings = int(np.count_nonzero(model.is_ring))
    return asdict(report.metrics) | {
        "file": item.file,
        "status": "succeeded",
        "n_lobes": model.n_lobes - rings,
        "ring_lobes": rings,
        "seconds": round(sum(report.timings.values()), 3),
        "output": item.output,
        "warnings": " ".join(report.warnings),
    }


def _relative_rms(item: FileFit) -> float:
    """Return what the table is sorted by; a fit without metrics comes last."""
    value = None if item.result is None else item.result.report.metrics.relative_rms
    return -math.inf if value is None else value
