"""The figures of Nishino 2009 on a folder of measurements: ``python -m benchmarks.paper figure1 --data DIR -o OUT``."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.paper.materials import STAND_INS, Failure, find_materials
from benchmarks.paper.paper_figure import make
from benchmarks.paper.report import FIGURES, write_report
from dsbrdf import DSBRDFError
from dsbrdf.process_settings import core_count

_REPORT = "report"


def main(words: Sequence[str] | None = None) -> int:
    """Make one figure, or a page with all of them; return 0, or 2 if a material could not be computed."""
    arguments = _parser().parse_args(words)
    output: Path = arguments.output
    try:
        found = find_materials(
            arguments.data,
            output / "kept" / "fits",
            names=arguments.materials,
            stand_ins=arguments.stand_ins,
        )
        output.mkdir(parents=True, exist_ok=True)
        if arguments.what == _REPORT:
            failures = write_report(found, output, jobs=arguments.jobs, progress=_progress("figures"))
            print(output / "report.html")
        else:
            (figure,) = (figure for figure in FIGURES if figure.name == arguments.what)
            chosen = list(found) if arguments.materials else figure.choose(found)
            made = make(figure, chosen, output, jobs=arguments.jobs, progress=_progress("materials"))
            failures = made.failures
            for claim in figure.claims(made.computed):
                print(f"{claim.verdict}: {claim.paper}\n  {claim.found}")
            print(f"{output / figure.name}.png, .svg, .csv")
    except DSBRDFError as error:
        print(error, file=sys.stderr)
        return 2
    return _tell(failures)


def _tell(failures: Sequence[Failure]) -> int:
    for failure in failures:
        print(f"{failure.file}: {failure.message}", file=sys.stderr)
    return 2 if failures else 0


def _progress(unit: str) -> Callable[[float], None]:
    return lambda done: print(f"{done:.4g} {unit}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paper", description=__doc__)
    parser.add_argument("what", choices=[*(figure.name for figure in FIGURES), _REPORT], help="a figure, or all")
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="a folder of MERL .binary files")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="results are kept there too")
    parser.add_argument("--materials", nargs="+", default=(), metavar="NAME", help="by default what suits each figure")
    parser.add_argument("--stand-ins", default=STAND_INS, metavar="PATTERN", help="files that are no measurements")
    parser.add_argument("--jobs", type=int, default=core_count(), metavar="N", help="processes")
    return parser


if __name__ == "__main__":
    sys.exit(main())
