"""The built documentation: no warning, no link that leads nowhere, nothing from other hosts."""

import json
import re
import runpy
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import dsbrdf
from tests.support.soak import SOAK

pytestmark = pytest.mark.slow

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the built pages, made of a copy of the sources; only ``make soak`` runs notebooks for it."""
    if find_spec("sphinx") is None or find_spec("myst_nb") is None:
        pytest.skip("Sphinx is not installed: make docs installs it")
    folder = tmp_path_factory.mktemp("docs")
    shutil.copytree(DOCS, folder / "docs", ignore=shutil.ignore_patterns("_build", "generated", "__pycache__"))
    command = [sys.executable, str(folder / "docs/_ext/build.py"), str(folder / "built")]
    command += [] if SOAK else ["--without-results"]
    built = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder / "built" / "html"


def test_site_has_a_page_for_each_public_name_and_the_references(site: Path) -> None:
    documented = {file.name for file in (site / "generated" / "api").glob("dsbrdf.*.html")}
    names = set(dsbrdf.__all__) - {"ALGORITHM_VERSION", "__version__"}
    assert {f"dsbrdf.{name}.html" for name in names} <= documented
    assert (site / "generated" / "api" / "dsbrdf_service.client.Client.html").is_file()
    assert (site / "model.html").read_text().count("<math ") > 20
    assert "dsbrdf fit" in (site / "command_reference.html").read_text()
    assert 'href="#post-v1-fits"' in (site / "http_reference.html").read_text()


def test_pages_show_spheres(site: Path) -> None:
    names = ("tutorial", "choices", "index", "gallery")
    tutorial, choices, index, gallery = ((site / f"{name}.html").read_text() for name in names)
    if SOAK:
        assert tutorial.count('alt="lit sphere"') == 3
        assert "the components add up: True" in tutorial
        assert "Traceback" not in tutorial + choices
        assert len(re.findall(r"\d dB +\d", choices)) == 8
    assert index.count('alt="lit spheres of aurora white') == 1
    assert gallery.count('alt="lit spheres: measured, fit, difference x 4') == 9
    assert "CC0 1.0" in gallery


def test_search_has_the_texts_of_all_pages_for_those_who_open_it_from_a_disk(site: Path) -> None:
    texts = json.loads((site / "_static" / "search_pages.js").read_text().partition(" = ")[2].removesuffix(";\n"))
    assert "This page follows one material" in texts["tutorial.html"]
    assert {"index.html", "generated/api/dsbrdf.fit.html"} <= set(texts)
    assert [file.name for file in site.glob("*.html") if "search_from_disk.js" in file.read_text()] == ["search.html"]


PAGE = """<html><head><link rel="stylesheet" href="style.css"><link rel="next" href="gone.html"></head><body id="top">
<a href="other.html#here">one</a> <a href="#below">two</a> <p id="below"><img src="data:image/png;base64,AA=="></p>
<a href="https://example.org/page">three</a>{}</body></html>"""
BAD_TAGS = """<a href="missing.html"><a href="other.html#nowhere"><a href="#nowhere"><img src="missing.png">
<script src="https://example.org/a.js"></script><img src="//example.org/a.png">"""
BAD_STYLES = (
    '@font-face { src: url("https://example.org/font.woff2") }',
    "a { background: url( //example.org/a.png) }",
    '@import "http://example.org/a.css";',
)


def test_faults_of_links_are_found(tmp_path: Path) -> None:
    links = runpy.run_path(str(DOCS / "_ext/links.py"))
    (tmp_path / "other.html").write_text('<h1 id="here">Other</h1>')
    style = tmp_path / "style.css"
    style.write_text("body { background: url(picture.png) }")
    (tmp_path / "index.html").write_text(PAGE.format(""))
    pages = links["read_pages"](tmp_path)
    assert links["faults"](tmp_path, pages) == []
    assert links["external"](pages) == ["https://example.org/page"]
    (tmp_path / "index.html").write_text(PAGE.format(BAD_TAGS))
    missing = ("missing.html", "other.html#nowhere", "#nowhere", "missing.png")
    loaded = ("https://example.org/a.js", "//example.org/a.png")
    wrong = {f"index.html links to {address}, which is not there" for address in missing}
    wrong |= {f"index.html loads {address} from another host" for address in loaded}
    assert set(links["faults"](tmp_path, links["read_pages"](tmp_path))) == wrong
    for text in BAD_STYLES:
        style.write_text(text)
        assert links["faults"](tmp_path, pages) == ["style.css loads a file from another host"]
