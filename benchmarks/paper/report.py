"""One self-contained page with all figures, and what their numbers say about the paper's sentences."""

from base64 import b64encode
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from pathlib import Path

from benchmarks.paper.figure1 import FIGURE as FIGURE_1
from benchmarks.paper.figure2 import FIGURE as FIGURE_2
from benchmarks.paper.figure3 import FIGURE as FIGURE_3
from benchmarks.paper.figure4 import FIGURE as FIGURE_4
from benchmarks.paper.figure5 import FIGURE as FIGURE_5
from benchmarks.paper.figure6 import FIGURE as FIGURE_6
from benchmarks.paper.materials import Failure, Material
from benchmarks.paper.paper_figure import Claim, Made, PaperFigure, make
from dsbrdf import ALGORITHM_VERSION, __version__
from dsbrdf.data.files import write_atomically

__all__ = ["FIGURES", "page", "write_report"]

FIGURES = (FIGURE_1, FIGURE_2, FIGURE_3, FIGURE_4, FIGURE_5, FIGURE_6)
"""All figures, in the order of the paper."""

# Figure 4 fits every material: with its fits kept, the others have less to do.
_ORDER = (FIGURE_4, FIGURE_1, FIGURE_2, FIGURE_3, FIGURE_6, FIGURE_5)

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; color: #212529; }
img { max-width: 100%; height: auto; }
table { border-collapse: collapse; }
th, td { border-bottom: 1px solid #ced4da; padding: .4rem .8rem; text-align: left; vertical-align: top; }
td:nth-child(1) { width: 28%; } td:nth-child(2) { white-space: nowrap; }
.agrees { color: #2b8a3e; } .in-part { color: #b35c00; } .differs { color: #c92a2a; }
h2 { margin-top: 3rem; }
"""


def write_report(
    materials: Sequence[Material],
    output: Path,
    *,
    jobs: int = 1,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Failure]:
    """Make all figures that there are enough materials for, and write ``report.html``; return each failure once.

    `progress` gets the number of finished figures, fractions included.
    """
    made: dict[str, Made] = {}
    for number, figure in enumerate(_ORDER):
        chosen = figure.choose(materials)
        if len(chosen) < figure.at_least:
            continue
        share = partial(_report_share, progress, number, len(chosen))
        made[figure.name] = make(figure, chosen, output, jobs=jobs, progress=share)
    in_order = [made[figure.name] for figure in FIGURES if figure.name in made]
    write_atomically(output / "report.html", [page(materials, in_order).encode()])
    return list(dict.fromkeys(failure for one in in_order for failure in one.failures))


def _report_share(progress: Callable[[float], None], number: int, count: int, done: float) -> None:
    """Tell how much is done of all figures when some of a figure's materials are."""
    progress(number + done / count)


def page(materials: Sequence[Material], made: Sequence[Made]) -> str:
    """Return the HTML page."""
    sections = "\n".join(_section(one) for one in made)
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>Nishino 2009, reproduced</title><style>{_STYLE}</style></head>
<body>
<h1>Directional Statistics BRDF Model: the paper's figures, reproduced</h1>
<p>Figures 1 to 6 of K. Nishino, “Directional Statistics BRDF Model”, ICCV 2009, computed by dsbrdf {__version__}
(algorithm version {ALGORITHM_VERSION}). “The paper's procedure” is Algorithm 1 on 18 slices, with Williams' test where
the number of lobes is not given (<code>method="paper"</code>); “the default fit” is <code>dsbrdf.fit</code> without
options.</p>
{_data(materials)}
{_summary(made)}
{sections}
</body>
</html>
"""


def _data(materials: Sequence[Material]) -> str:
    measured = [material.name for material in materials if material.measured]
    stand_ins = [material.name for material in materials if not material.measured]
    parts = [
        "<h2>The data</h2>",
        f"<p><b>Measured</b> ({len(measured)}): {escape(', '.join(measured)) or 'none'}.</p>",
        f"<p><b>Stand-ins</b> ({len(stand_ins)}), marked with an asterisk:"
        f" {escape(', '.join(stand_ins)) or 'none'}.</p>",
    ]
    if stand_ins:
        parts.append(
            "<p>Stand-ins are not measurements. They are tables decoded from another program's compact description of"
            " the MERL materials: smooth, without the noise, the outliers and the scatter at the rim of the"
            " measurements, and least reliable at grazing angles. What is found on them need not hold for the MERL"
            " measurements that the paper used; every sentence below that rests on them is to be read that way.</p>"
        )
    return "\n".join(parts)


def _summary(made: Sequence[Made]) -> str:
    rows = "\n".join(
        f'<tr><td><a href="#{one.figure.name}">{_name(one.figure)}</a>: {escape(claim.paper)}</td>'
        f"<td>{_verdict(claim)}</td></tr>"
        for one in made
        for claim in one.figure.claims(one.computed)
    )
    return f"<h2>In short</h2>\n<table>\n{rows}\n</table>"


def _section(made: Made) -> str:
    figure = made.figure
    stand_ins = sum(not one.measured for one in made.computed)
    rows = "\n".join(
        f"<tr><td>{escape(claim.paper)}</td><td>{_verdict(claim)}</td><td>{escape(claim.found)}</td></tr>"
        for claim in figure.claims(made.computed)
    )
    failed = "".join(f"<p>Left out: {escape(one.file.name)}: {escape(one.message)}</p>" for one in made.failures)
    return f"""<h2 id="{figure.name}">{_name(figure)}: {escape(figure.title)}</h2>
<p>{escape(figure.shows)} {len(made.computed)} materials, {stand_ins} of them stand-ins (*).</p>
<img alt="{escape(figure.title)}" src="data:image/png;base64,{b64encode(made.picture).decode()}">
<p>Numbers: <code>{figure.name}.csv</code>; for print: <code>{figure.name}.svg</code>.</p>
{failed}
<table><tr><th>The paper</th><th></th><th>Found here</th></tr>
{rows}
</table>"""


def _verdict(claim: Claim) -> str:
    return f'<span class="{claim.verdict.replace("agrees in part", "in-part")}">{claim.verdict}</span>'


def _name(figure: PaperFigure) -> str:
    return figure.name.replace("figure", "Figure ").capitalize()
