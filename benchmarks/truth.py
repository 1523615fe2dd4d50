"""How true the components are to materials of others, whose specular and diffuse light is known (Mitsuba with LLVM).

Moved is the light on the wrong side of specular and diffuse as a share of all light, channels added: the mean of
0, 40 and 70 degrees to the normal. Where the specular light is that of one layer of microfacets, its roughness alpha
and its reflectance F0 are compared; inside says whether the true share of the diffuse light at normal incidence lies
within the range of 90 % that the decomposition states.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import dsbrdf
from dsbrdf.errors import ConvergenceWarning
from tests.support.foreign_materials import CATALOGUE, Material, drawn
from tests.support.foreign_truth import Judgement, Truth, judged


def fitted(name: str, material: Material, noise: float, folder: Path | None) -> tuple[dsbrdf.DSBRDF, Truth]:
    """Fit a material; return the model and the truth, which are kept in the folder if there is one."""
    result, truth = dsbrdf.fit(dsbrdf.profiles(material.measurement(name, noise))), Truth.of(material)
    if folder is not None:
        dsbrdf.save(result, folder / f"{name}.json")
        truth.save(folder / f"{name}.npz")
    return result.model, truth


def print_row(name: str, found: Judgement) -> None:
    """Print one line of the table."""
    layer = "" if found.alpha is None else f", alpha {found.alpha:+6.1%}"
    layer += "" if found.f0 is None else f", F0 {found.f0:5.1%}"
    low, high = found.range
    stated = f"{low:.3f} to {high:.3f} {'holds' if found.inside else 'MISSES'} {found.true_share:.3f}"
    angles = " ".join(f"{moved:6.1%}" for moved in found.moved)
    print(f"{name:28} moved {angles}; diffuse {found.share:.3f}, {stated}{layer}; {found.structure}", flush=True)


def print_summary(rows: Sequence[Judgement]) -> None:
    """Print the spread of all figures."""
    moved = np.array([row.moved.mean() for row in rows])
    median, p90, largest = np.quantile(moved, [0.5, 0.9, 1.0])
    print(f"moved: mean {moved.mean():.2%}, median {median:.2%}, p90 {p90:.2%}, largest {largest:.2%} of {len(rows)}")
    for name, errors in (("alpha", [row.alpha for row in rows]), ("F0", [row.f0 for row in rows])):
        if sizes := [abs(error) for error in errors if error is not None]:
            print(f"{name} of {len(sizes)} with one layer: median {np.median(sizes):.1%}, largest {max(sizes):.1%}")
    widths = [row.range[1] - row.range[0] for row in rows]
    print(f"true share inside its range: {np.mean([row.inside for row in rows]):.0%}, widths: {np.median(widths):.3f}")


def main(argv: Sequence[str] | None = None) -> int:
    """Print a line for each material, and the spread."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks truth", description=__doc__)
    parser.add_argument("--names", default="", help="only materials whose name contains one of these, with commas")
    parser.add_argument("--random", type=int, metavar="N", help="N materials drawn at random instead of the catalogue")
    parser.add_argument("--seed", type=int, default=1, help="of the random materials (default: 1)")
    parser.add_argument("--noise", type=float, default=0.0, help="relative noise of every value (default: 0)")
    models_help = "keep fits and truth there, and take those that are there; these are decomposed anew, with the time"
    parser.add_argument("--models", type=Path, metavar="DIR", help=models_help)
    arguments = parser.parse_args(argv)
    materials = drawn(arguments.random, arguments.seed) if arguments.random else CATALOGUE
    words = arguments.names.split(",")
    chosen = {name: material for name, material in materials.items() if any(word in name for word in words)}
    if not chosen:
        raise SystemExit(f"no material has one of {arguments.names} in its name")
    kind = f"random_{arguments.seed}" if arguments.random else "catalogue"
    folder = arguments.models and arguments.models / f"{kind}_noise_{arguments.noise:g}"
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    rows, seconds = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for name, material in chosen.items():
            if folder is not None and (folder / f"{name}.npz").exists():
                model, truth = dsbrdf.load(folder / f"{name}.json"), Truth.load(folder / f"{name}.npz")
                start = time.perf_counter()
                parts = dsbrdf.decompose(model)
                seconds.append(time.perf_counter() - start)
            else:
                model, truth = fitted(name, material, arguments.noise, folder)
                parts = dsbrdf.decompose(model)  # as the fit left it
            rows.append(judged(parts, truth))
            print_row(name, rows[-1])
    print_summary(rows)
    if seconds:
        print(f"decompose: median {np.median(seconds):.2f} s, largest {max(seconds):.2f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
