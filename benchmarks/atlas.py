"""Make the fits of measured materials again that come with the package, and print how well they fit.

``DSBRDF_REFERENCE_DATA`` has the measurements as ``rgl_NAME.binary``. For each material: the number of lobes, the PSNR
of a lit sphere, the excess error, and the size of its file.
"""

import argparse
import json
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dsbrdf import ConvergenceWarning, fit, read_merl
from dsbrdf.output.atlas import FOLDER
from dsbrdf.output.serialize import to_json

PREFIX = "rgl_"
DIGITS = 7


def main(argv: Sequence[str]) -> int:
    """Write a file for each material into the package, and print one line for each."""
    argparse.ArgumentParser(prog="python -m benchmarks atlas", description=__doc__).parse_args(argv)
    files = sorted(Path(os.environ.get("DSBRDF_REFERENCE_DATA", "")).glob(f"{PREFIX}*.binary"))
    if not files:
        print(f"set DSBRDF_REFERENCE_DATA to a folder with {PREFIX}*.binary to make the atlas again")
        return 0
    total = 0
    for path in files:
        with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
            result = fit(read_merl(path))
        name, metrics = path.stem.removeprefix(PREFIX), result.report.metrics
        document = rounded(json.loads(to_json(result.model, result.report)))
        written = (FOLDER / f"{name}.json").write_text(json.dumps(document, separators=(",", ":")) + "\n")
        total += written
        print(f"{name:22}{result.model.n_lobes:3} lobes{metrics.psnr:7.1f} dB{metrics.excess:9.4f}{written:8} bytes")
    print(f"{len(files)} materials, {total} bytes")
    return 0


def rounded(content: Any) -> Any:
    """Return JSON content whose numbers have at most `DIGITS` digits."""
    match content:
        case dict():
            return {name: rounded(value) for name, value in content.items()}
        case list():
            return [rounded(value) for value in content]
        case float():
            return float(f"{content:.{DIGITS}g}")
    return content
