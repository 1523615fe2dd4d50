"""The command ``dsbrdf paper``: the figures of Nishino 2009 on a folder of measurements, and a report of them all."""

import argparse
from pathlib import Path

from dsbrdf.cli.arguments import BAD_INPUT, whole_number
from dsbrdf.cli.progress import progress_bar
from dsbrdf.paper.materials import STAND_INS, Failure, Material, find_materials
from dsbrdf.paper.paper_figure import make
from dsbrdf.paper.report import FIGURES, write_report
from dsbrdf.process_settings import core_count

_REPORT = "report"


def configure(parser: argparse.ArgumentParser, _: str) -> None:
    """Add the arguments of the command to its parser."""
    parser.set_defaults(run=_run)
    names = [*(figure.name for figure in FIGURES), _REPORT]
    parser.add_argument("what", choices=names, metavar="|".join(names), help="one figure, or a page with all of them")
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="a folder of MERL .binary files")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="OUT",
        help="the folder to write to; results of materials are kept there and used again",
    )
    parser.add_argument(
        "--materials", nargs="+", default=[], metavar="NAME", help="only these; by default what suits each figure"
    )
    parser.add_argument(
        "--stand-ins",
        default=STAND_INS,
        metavar="PATTERN",
        help="names of files that are no measurements but decoded descriptions; default: %(default)s",
    )
    parser.add_argument(
        "--peers",
        type=Path,
        metavar="DIR",
        help="a folder of the same materials as another model encodes them, peer_NAME.binary: points in the footprint",
    )
    parser.add_argument("--jobs", type=whole_number, metavar="N", help="processes (default: one for each core)")


def _run(arguments: argparse.Namespace) -> int:
    output: Path = arguments.output
    output.mkdir(parents=True, exist_ok=True)
    jobs = core_count() if arguments.jobs is None else arguments.jobs
    materials = find_materials(
        arguments.data,
        output / "kept" / "fits",
        names=arguments.materials,
        stand_ins=arguments.stand_ins,
        peers=arguments.peers,
    )
    if arguments.what == _REPORT:
        with progress_bar(len(FIGURES), "figures") as progress:
            failures = write_report(materials, output, jobs=jobs, progress=progress)
            progress.write(str(output / "report.html"))
    else:
        failures = _one_figure(arguments, materials, output, jobs)
    return BAD_INPUT if failures else 0


def _one_figure(
    arguments: argparse.Namespace, materials: tuple[Material, ...], output: Path, jobs: int
) -> list[Failure]:
    (figure,) = (figure for figure in FIGURES if figure.name == arguments.what)
    chosen = list(materials) if arguments.materials else figure.choose(materials)
    with progress_bar(len(chosen), "materials") as progress:
        made = make(figure, chosen, output, jobs=jobs, progress=progress)
        for failure in made.failures:
            progress.write(f"dsbrdf: {failure.file}: {failure.message}", error=True)
        for claim in figure.claims(made.computed):
            progress.write(f"{claim.verdict}: {claim.paper}\n  {claim.found}")
        progress.write(f"{output / figure.name}.png, .svg, .csv")
    return made.failures
