"""The command ``dsbrdf paper``: the figures of Nishino 2009 on a folder of measurements, and a report of them all."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dsbrdf.cli.arguments import BAD_INPUT
from dsbrdf.cli.parameters import Folder, Jobs, OutputFolder
from dsbrdf.cli.progress import progress_bar
from dsbrdf.paper.materials import STAND_INS, Failure, Material, find_materials
from dsbrdf.paper.paper_figure import PaperFigure, make
from dsbrdf.paper.report import FIGURES, write_report
from dsbrdf.process_settings import core_count

_REPORT = "report"

What = Annotated[str, Parameter(choices=[*(figure.name for figure in FIGURES), _REPORT])]
Names = Annotated[tuple[str, ...], Parameter(metavar="NAME...", consume_multiple=1)]


def paper(
    what: What,
    /,
    *,
    data: Folder,
    output: OutputFolder,
    materials: Names = (),
    stand_ins: Annotated[str, Parameter(metavar="PATTERN")] = STAND_INS,
    peers: Folder | None = None,
    jobs: Jobs = None,
) -> int:
    """Make figures of Nishino 2009, or a page with all of them; return the exit code.

    Parameters
    ----------
    what
        One figure, or a page with all of them.
    data
        A folder of MERL .binary files.
    output
        The folder to write to; results of materials are kept there and used again.
    materials
        Only these; by default what suits each figure.
    stand_ins
        Names of files that are no measurements but decoded descriptions.
    peers
        A folder of the same materials as another model encodes them, peer_NAME.binary: points in the footprint.
    jobs
        Processes; by default one for each core.
    """
    output.mkdir(parents=True, exist_ok=True)
    found = find_materials(data, output / "kept" / "fits", names=materials, stand_ins=stand_ins, peers=peers)
    processes = core_count() if jobs is None else jobs
    if what == _REPORT:
        with progress_bar(len(FIGURES), "figures") as progress:
            failures = write_report(found, output, jobs=processes, progress=progress)
            progress.write(str(output / "report.html"))
    else:
        (figure,) = (figure for figure in FIGURES if figure.name == what)
        failures = _one_figure(figure, list(found) if materials else figure.choose(found), output, processes)
    return BAD_INPUT if failures else 0


def _one_figure(figure: PaperFigure, chosen: list[Material], output: Path, jobs: int) -> list[Failure]:
    with progress_bar(len(chosen), "materials") as progress:
        made = make(figure, chosen, output, jobs=jobs, progress=progress)
        for failure in made.failures:
            progress.write(f"dsbrdf: {failure.file}: {failure.message}", error=True)
        for claim in figure.claims(made.computed):
            progress.write(f"{claim.verdict}: {claim.paper}\n  {claim.found}")
        progress.write(f"{output / figure.name}.png, .svg, .csv")
    return made.failures
