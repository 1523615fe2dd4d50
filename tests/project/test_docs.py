"""The documentation cannot drift: every block of README and pages is run, every name they promise exists."""

import os
import pty
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Iterator
from contextlib import redirect_stdout
from io import BytesIO, StringIO
from pathlib import Path
from shutil import copytree, ignore_patterns
from typing import Any

import httpx
import numpy as np
import pytest
from matplotlib.image import imread
from PIL import Image

import dsbrdf
from dsbrdf.cli import compare_command
from dsbrdf.cli import main as cli
from dsbrdf.data.rgl import RglMaterial
from dsbrdf.fitting import METRICS
from dsbrdf.output.export import materialx
from dsbrdf.output.export.openpbr import OpenPBR
from dsbrdf.output.sphere_panels import compare_spheres
from dsbrdf_service.settings import Settings
from examples import demo
from examples.demo import stop
from tests.support.command_line import FEW_LOBES, Capture, run_main
from tests.support.renderers import mitsuba_variant
from tests.support.soak import SOAK

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse_sampling")]

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text()
ADDRESS = "http://127.0.0.1:8000"
PAGES = {file.name: file.read_text() for file in sorted(DOCS.glob("*.md"))}
NOTEBOOKS = {"tutorial.md", "choices.md"}
SPHINX = {"{code-cell}", "{toctree}", "{include}", "{eval-rst}"}


def blocks_of(text: str) -> list[tuple[str, str]]:
    return [(match[1], match[2]) for match in re.finditer(r"^```(\S*).*\n((?s:.*?))^```$", text, re.MULTILINE)]


def blocks(language: str, *, http: bool) -> list[str]:
    """The blocks of all pages in one language that need a running service, or that do not."""
    # The page of Python writes the files that the others use.
    pages = sorted(PAGES, key=lambda page: page != "python.md")
    found = [block for page in pages for block in blocks_of(PAGES[page])]
    return [text for name, text in found if name == language and (ADDRESS in text) is http]


def commands(text: str) -> list[str]:
    return [line for line in text.replace("\\\n", " ").splitlines() if line.strip()]


def words_of(line: str) -> list[str]:
    """The arguments of a command, with the names of files that a shell would put in place of a pattern."""
    words = shlex.split(line)[1:]
    return [name for word in words for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]


def compare_small(*shown: Any, **options: Any) -> Any:
    return compare_spheres(*shown, **options | {"size": 64})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("readme")
    copytree(ROOT / "examples", made / "examples", ignore=ignore_patterns("*.py"))
    return made


@pytest.fixture(scope="module")
def read_once(satin_purple_file: Path, coarse_sampling: None) -> Iterator[None]:
    """Read the file of the examples only once: that takes most of their time."""
    measured = dsbrdf.read_merl(satin_purple_file)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RglMaterial, "measurement", lambda _: measured)
        yield


@pytest.fixture(scope="module")
def python_quick_start(folder: Path, read_once: None) -> dict[str, Any]:
    names, printed = dict[str, Any](), StringIO()
    with redirect_stdout(printed), pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore", dsbrdf.ConvergenceWarning)
        patch.chdir(folder)
        for number, text in enumerate(blocks("python", http=False)):
            exec(compile(text, f"Python block {number}", "exec"), names)
            if text.startswith("result = dsbrdf.fit(measurement)"):
                names["fitted"] = names["result"]
    return names | {"printed": printed.getvalue()}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address, told at a terminal, of the service that the pages start, which ends with its command."""
    (line,) = [line for text in blocks("sh", http=False) for line in commands(text) if line.startswith("dsbrdf serve")]
    words, folder = line.split(), tmp_path_factory.mktemp("served")
    words[words.index("--port") + 1] = "0"
    command = [sys.executable, "-m", "dsbrdf.cli.main", *words[1:]]
    leader, follower = pty.openpty()
    with (folder / "log").open("wb") as log, os.fdopen(leader) as told:
        process = subprocess.Popen(command, cwd=folder, stdout=follower, stderr=log)
        os.close(follower)
        try:
            address = re.search(r"dsbrdf serves at (http://127\.0\.0\.1:\d+); Ctrl-C stops it\.", told.readline())
            assert address
            assert (folder / Settings().data_dir).is_dir()
            yield address[1]
        finally:
            stop(process)
    assert process.returncode == 0
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{address[1]}/health/live", timeout=5)


def test_every_block_is_run() -> None:
    languages = {name: {language for language, _ in blocks_of(text)} for name, text in PAGES.items()}
    assert set().union(*languages.values()) - SPHINX == {"python", "sh", "text", "ini", "yaml"}
    assert {name for name, used in languages.items() if "{code-cell}" in used} == NOTEBOOKS
    shell = [command.split()[0] for text in blocks("sh", http=False) for command in commands(text)]
    assert set(shell) == {"dsbrdf"}


def test_readme_shows_blocks_of_the_pages_only() -> None:
    shown = blocks_of(README)
    assert {language for language, _ in shown} == {"python", "sh", "text", "bibtex"}
    lines = {line for text in blocks("sh", http=False) for line in commands(text)}
    for language, text in shown:
        if language == "sh" and ADDRESS not in text:
            assert set(commands(text)) <= lines
        elif language in ("python", "sh"):
            assert text in blocks(language, http=ADDRESS in text)


def test_readme_shows_a_sharp_and_small_picture_of_measured_materials() -> None:
    pictures = runpy.run_path(str(DOCS / "_ext/pictures.py"))
    file = pictures["README_PICTURE"]
    assert f"({file.relative_to(ROOT)})" in README
    titles = [name.removeprefix("rgl_").replace("_", " ") for name in pictures["README_MATERIALS"]]
    assert [title for title in titles if title not in README] == []
    assert file.stat().st_size < 600_000
    with Image.open(file) as shown:
        assert shown.width >= 1600
        seen = np.asarray(shown.convert("RGBA"), dtype=float)
    if SOAK and (folder := os.environ.get("DSBRDF_REFERENCE_DATA")):
        with Image.open(BytesIO(pictures["readme_picture"](Path(folder)))) as drawn:
            assert (drawn.width, drawn.height) == (seen.shape[1], seen.shape[0])
            difference = np.abs(seen - np.asarray(drawn.convert("RGBA"), dtype=float))
        rows = np.array_split(difference, len(titles))
        assert max(row.mean() for row in rows) < 0.5, "run: python docs/_ext/pictures.py"


def test_commands_of_the_pages_have_their_options() -> None:
    reference = runpy.run_path(str(DOCS / "_ext/reference.py"))["command_line"]()
    helps = dict(re.findall(r"^## dsbrdf ([\w ]+)\n\n```text\n((?s:.*?))```", reference, re.MULTILINE))
    text = "\n".join((README, *PAGES.values()))
    lines = re.findall(r"^(?: {4})?dsbrdf .*", text, re.MULTILINE)
    assert len(lines) > 30
    for line in lines:
        _, command, *words = re.split(r" {3,}", line.strip())[0].split()
        options = {word for word in words if word.startswith("--")}
        known = helps[f"{command} {words[0]}" if command == "keys" else command]
        assert options <= set(re.findall(r"--[a-z-]+", known)), line


def test_the_python_quick_start(python_quick_start: dict[str, Any], folder: Path) -> None:
    assert "succeeded" in python_quick_start["printed"].splitlines()  # The service in this process says so.
    assert python_quick_start["values"].shape == (3, 3)
    assert dsbrdf.load(folder / "paint.json") == python_quick_start["fitted"]
    assert dsbrdf.read_merl(folder / "paint-model.binary").valid.any()


@pytest.mark.usefixtures("read_once")
@pytest.mark.parametrize(
    ("page", "printed", "times"), [("tutorial.md", "the components add up: True", 1), ("choices.md", r"dB +\d", 8)]
)
def test_cells_of_notebooks_run(
    page: str, printed: str, times: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for number, (language, text) in enumerate(blocks_of(PAGES[page])):
        if language == "{code-cell}":
            exec(compile(re.sub("^:tags:.*", "", text), f"cell {number} of {page}", "exec"), names)
    assert len(re.findall(printed, capsys.readouterr().out)) == times


@pytest.mark.usefixtures("python_quick_start")
def test_the_command_line_quick_start(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = [line for text in blocks("sh", http=False) for line in commands(text)]
    # What more than one page shows is run once.
    lines = [line for line in dict.fromkeys(every) if not line.startswith("dsbrdf serve")]
    used = {line.split()[1] for line in lines}
    assert used == {"materials", "fit", "show", "eval", "decompose", "export", "convert", "render", "plot", "compare"}
    (tmp_path / "paint.binary").hardlink_to(folder / "paint.binary")  # the one file to be fitted
    # The fit of a MaterialX surface has tests of its own.
    surface = materialx.FoundSurface(OpenPBR((0.5, 0.5, 0.5)), {"three_lights": 30.0}, {"highlight": 25.0})
    monkeypatch.setattr(materialx, "fit_openpbr", lambda *_: surface)
    monkeypatch.setattr(compare_command, "compare_spheres", compare_small)
    monkeypatch.chdir(tmp_path)
    shown = [run_main(cli.main, *words_of(line)) for line in lines]
    assert [answer.returncode for answer in shown] == [0] * len(lines)
    assert "relative_rms" in shown[0].stdout


@pytest.mark.usefixtures("python_quick_start")
def test_the_http_quick_start_with_curl(service: str, folder: Path) -> None:
    (text,) = blocks("sh", http=True)
    script = text.replace(ADDRESS, service)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    command, environment = ["bash", "-euo", "pipefail", "-c", script], os.environ | {"PATH": path}
    answer = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert answer.returncode == 0, f"{script}\n{answer.stdout}\n{answer.stderr}"
    assert '"values"' in answer.stdout
    assert '"diffuse"' in answer.stdout


@pytest.mark.usefixtures("python_quick_start")
def test_the_http_quick_start_in_python(service: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    for number, text in enumerate(blocks("python", http=True)):
        exec(compile(text.replace(ADDRESS, service), f"HTTP block {number}", "exec"), names)
        if "httpx.Client(" in text:
            answered = dict(names)
    assert names["paint"]["id"] == names["same"]["id"]
    names = answered
    assert len(names["answer"]["values"]) == 3
    assert names["fit"]["status"] == "succeeded"


def test_the_targets_of_make_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    documents = "".join(PAGES.values()) + README + (ROOT / "CONTRIBUTING.md").read_text()
    assert set(re.findall(r"(?:^|`)make ([a-z]+)", documents, re.MULTILINE)) <= targets
    assert {"demo", "serve", "docs", "test", "check", "fix", "bench", "lock"} <= targets


def test_page_on_installation_lists_the_extras_of_the_package() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    table = PAGES["install.md"].partition("| extra | brings |")[2].partition("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)`", table, re.MULTILINE)) == set(extras)


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_to_files_lead_somewhere(name: str) -> None:
    links = re.findall(r"\]\(([^)]+)\)", (ROOT / name).read_text())
    assert [link for link in links if "://" not in link and not (ROOT / link.partition("#")[0]).exists()] == []


def test_glossary_names_all_metrics_and_parameters() -> None:
    parameters = ("amplitude", "kappa", "gamma", "center", "elongation", "delta", "lobe", "n_lobes", "mask")
    assert [name for name in (*METRICS, *parameters) if f"`{name}`" not in PAGES["glossary.md"]] == []


def test_the_table_becomes_a_sphere_with_a_purple_highlight_and_says_what_its_fit_is_worth(tmp_path: Path) -> None:
    model, table = tmp_path / "satin-purple.json", DOCS / "_static" / "satin-purple.csv"
    said = run_main(cli.main, "fit", str(table), "-o", str(tmp_path), *FEW_LOBES).stdout
    assert re.search(r"error [\d.]+% at the samples, probably below [\d.]+% over all directions", said)
    mitsuba = mitsuba_variant("scalar_rgb")
    assert cli.main(["export", str(model), "-o", str(tmp_path / "satin.bsdf"), "--example"]) == 0
    picture = np.array(mitsuba.render(mitsuba.load_file(str(tmp_path / "satin.xml")), spp=4))
    pixels = picture[..., :3].reshape(-1, 3)
    red, green, blue = pixels[np.argmax(pixels[:, 0])]
    assert min(red, blue) > 1.1 * green  # the highlight is purple, the rest is not
    assert 0.1 < picture[128, 100, :3].mean() < 0.9
    assert np.isfinite(picture).all()


_COMPONENT = re.compile(r"^(\w+) +\d+% +\d+%-\d+%(?: +([\d.]+)°)?" + r" +([\d.]+)" * 3 + "$", re.MULTILINE)


@pytest.mark.usefixtures("read_once")
def test_demo_prints_all_results_and_stops_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demo, "compare_spheres", compare_small)
    demo.main(tmp_path / "out")
    out = capsys.readouterr().out
    words = ["201 Created", "200 OK", "90 % range", "width", "tail", "relative_rms", "excess", "male"]
    assert [word for word in words if word not in out] == []
    rows = re.findall(r"^ +[\d.]+° +\d+°((?: +[\d.]+){6})$", out, re.MULTILINE)
    assert len(rows) == len(demo.SHOWN_THETA_HALF_NODES) * len(demo.SHOWN_THETA_DIFF_NODES)
    peak = [float(word) for word in rows[0].split()]
    assert peak[1::2] == pytest.approx(peak[0::2], rel=0.1)  # fitted next to measured
    found = {row[0]: [float(word or "nan") for word in row[1:]] for row in _COMPONENT.findall(out)}
    assert list(found) == ["specular_lobe", "diffuse"]
    width, red, green, blue = found["specular_lobe"]
    assert width == pytest.approx(4.3, abs=1.0)
    assert green < red < blue  # The paint is grey with a purple highlight.
    assert found["diffuse"][1:] == pytest.approx([np.mean(found["diffuse"][1:])] * 3, rel=0.15)
    image = imread(BytesIO((tmp_path / "out/demo.png").read_bytes()), format="png")
    assert min(image.shape[:2]) > 800
    assert image[..., :3].std() > 0.05
    address = re.search(r"http://[\d.]+:\d+", out)
    assert address is not None
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{address[0]}/health/live", timeout=5)


def test_demo_shows_the_log_of_a_service_that_fails_to_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\necho it broke\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with pytest.raises(RuntimeError, match=r"the service did not start.*\n.*it broke"), demo.running_service(tmp_path):
        pytest.fail("nothing is running")
