"""The page: one file, all figures, and plain words about what is measured."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper import report
from benchmarks.paper.materials import Computed, Failure, Material
from benchmarks.paper.paper_figure import Claim, Made, PaperFigure, new_figure
from benchmarks.paper.report import FIGURES, page, write_report

MATERIALS = (
    Material(Path("merl_a<b>.binary"), Path(), measured=False),
    Material(Path("rgl_satin.binary"), Path(), measured=True),
)


def figure_named(name: str) -> PaperFigure:
    return PaperFigure(
        name=name,
        title=f"title of {name}",
        shows="What is shown.",
        choose=list,
        measure=lambda material: {"length": np.array(len(material.name))},
        table=lambda computed: [{"material": one.name, "length": int(one["length"])} for one in computed],
        draw=lambda computed: new_figure(f"{len(computed)} materials", 2.0, 1.0),
        claims=_claims,
    )


def _claims(computed: Sequence[Computed]) -> list[Claim]:
    return [Claim("It is <so>.", "agrees in part", f"Lengths sum to {sum(int(one['length']) for one in computed)}.")]


def test_page_is_self_contained_and_tells_what_is_measured() -> None:
    made = Made(figure_named("figure3"), [Computed("x", False, {"length": np.array(7)})], b"picture", [])
    text = page(MATERIALS, [made])
    assert re.findall(r'(?:src|href)="([^"]{1,30})', text) == ["#figure3", "data:image/png;base64,cGljdHVy"]
    for said in (
        "<b>Measured</b> (1): rgl_satin.",
        "<b>Stand-ins</b> (1), marked with an asterisk: merl_a&lt;b&gt;.",
        "Stand-ins are not measurements.",
        "It is &lt;so&gt;.",
        "Lengths sum to 7.",
        '<span class="in-part">agrees in part</span>',
        "1 materials, 1 of them stand-ins",
    ):
        assert said in text
    assert "Stand-ins are not measurements." not in page(MATERIALS[1:], [])


def test_figures_have_the_names_of_the_paper() -> None:
    assert [figure.name for figure in FIGURES] == [f"figure{number}" for number in range(1, 7)]
    assert set(report._ORDER) == set(FIGURES)


def test_report_makes_every_figure_and_names_each_failure_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = (figure_named("figure1"), figure_named("figure2"))
    monkeypatch.setattr(report, "FIGURES", figures)
    monkeypatch.setattr(report, "_ORDER", figures[::-1])
    good, done = Material(tmp_path / "good.binary", tmp_path), list[float]()
    good.file.touch()
    assert write_report([good], tmp_path, progress=done.append) == []
    assert done == [1.0, 2.0]
    text = (tmp_path / "report.html").read_text()
    assert text.index("title of figure1") < text.index("title of figure2")
    failure = Failure(tmp_path / "bad.binary", "is <bad>")
    made = Made(figures[0], [], b"", [failure])
    assert "Left out: bad.binary: is &lt;bad&gt;" in page([good], [made])
