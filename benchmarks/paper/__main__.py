"""The figures of Nishino 2009 on a folder of measurements: ``python -m benchmarks.paper figure1 --data DIR -o OUT``."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.paper import figure1, figure2, figure3, figure4, figure5, figure6
from benchmarks.paper.base import PaperFigure, compute, find_materials, save
from dsbrdf.process_settings import core_count

FIGURES: tuple[PaperFigure, ...] = (figure1, figure2, figure3, figure4, figure5, figure6)
STAND_INS = """Materials with an asterisk are stand-ins, not measurements: tables decoded from another program's
description of the MERL materials, smooth, without the noise, the outliers and the scatter at the rim of the
measurements, and least reliable at grazing angles. Judgements that rest on them need not hold for measurements."""


def main(words: Sequence[str] | None = None) -> int:
    """Make one figure and print its claims, or all figures and ``report.md``."""
    names = {figure.__name__.rpartition(".")[2]: figure for figure in FIGURES}
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paper", description=__doc__)
    parser.add_argument("what", choices=[*names, "report"], help="a figure, or all")
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="a folder of MERL .binary files")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="results are kept there too")
    parser.add_argument("--materials", nargs="+", default=(), metavar="NAME", help="by default what suits each figure")
    parser.add_argument("--stand-ins", default="merl_*", metavar="PATTERN", help="files that are no measurements")
    parser.add_argument("--jobs", type=int, default=core_count(), metavar="N", help="processes")
    arguments = parser.parse_args(words)
    output: Path = arguments.output
    output.mkdir(parents=True, exist_ok=True)
    found = find_materials(arguments.data, output / "kept" / "fits", arguments.materials, arguments.stand_ins)
    report = ["# Nishino 2009, reproduced", STAND_INS]
    for name, figure in names.items():
        if arguments.what not in (name, "report"):
            continue
        chosen = found if arguments.materials else figure.choose(found)
        computed = compute(figure, chosen, output / "kept" / name, arguments.jobs)
        if not computed:
            raise SystemExit(f"{name} has no material")
        save(figure, computed, output)
        claims = [f"- {verdict}: {paper}\n  {said}" for paper, verdict, said in figure.claims(computed)]
        report += [
            f"## {name}",
            sys.modules[figure.__name__].__doc__ or "",
            f"![{name}]({name}.png)",
            "\n".join(claims),
        ]
        print("\n".join(claims))
    if arguments.what == "report":
        (output / "report.md").write_text("\n\n".join(report) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
