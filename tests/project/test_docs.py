"""The documentation cannot drift: every block of the README is run, every name it promises exists."""

import os
import re
import shlex
import subprocess
import sys
import time
import tomllib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

import dsbrdf
from dsbrdf.cli import main as cli
from dsbrdf.cli.demo import running_service, stop
from dsbrdf.fitting.metrics import METRICS
from dsbrdf.model.decomposition import LABELS
from dsbrdf.output.export import materialx
from service.settings import Settings
from tests.support.commands import run_main

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
ADDRESS = "http://127.0.0.1:8000"
BLOCKS = [(match[1], match[2]) for match in re.finditer(r"^```(\w*)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)]


def blocks(language: str, *, http: bool) -> list[str]:
    return [text for name, text in BLOCKS if name == language and (ADDRESS in text) is http]


def commands(text: str) -> list[str]:
    """The commands of a shell block, continued lines joined."""
    return [line for line in text.replace("\\\n", " ").splitlines() if line.strip()]


def words_of(line: str) -> list[str]:
    """The arguments of a command, with the names of files that a shell would put in place of a pattern."""
    words = shlex.split(line)[1:]
    return [name for word in words for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]


def run_shell(script: str, folder: Path) -> str:
    """Output of a script, with this environment's commands first."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    answer = subprocess.run(
        ["bash", "-e", "-u", "-o", "pipefail", "-c", script],
        cwd=folder,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, f"{script}\n{answer.stdout}\n{answer.stderr}"
    return answer.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("readme")


@pytest.fixture(scope="module")
def python_quick_start(folder: Path) -> dict[str, Any]:
    """Names that the Python blocks leave behind, run in order in one folder."""
    names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore", dsbrdf.ConvergenceWarning)
        patch.chdir(folder)
        for number, text in enumerate(blocks("python", http=False)):
            exec(compile(text, f"README.md, Python block {number}", "exec"), names)
    return names


@pytest.fixture(scope="module")
def service(folder: Path) -> Iterator[str]:
    with running_service(folder) as url:
        yield url


def test_every_readme_block_is_run() -> None:
    assert {language for language, _ in BLOCKS} == {"python", "sh", "text", "bibtex"}
    shell = [command.split()[0] for text in blocks("sh", http=False) for command in commands(text)]
    assert set(shell) == {"dsbrdf"}
    assert len(blocks("python", http=False)) >= 5
    assert len(blocks("sh", http=True)) == len(blocks("python", http=True)) == 1


def test_the_python_quick_start(python_quick_start: dict[str, Any], folder: Path) -> None:
    assert python_quick_start["values"].shape == (3, 3)
    assert python_quick_start["same"].shape == (3,)
    assert dsbrdf.load(folder / "paint.json").n_lobes == python_quick_start["result"].model.n_lobes
    assert dsbrdf.read_merl(folder / "paint-model.binary").valid.any()


@pytest.mark.usefixtures("python_quick_start")
def test_the_command_line_quick_start(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [
        line for text in blocks("sh", http=False) for line in commands(text) if not line.startswith("dsbrdf serve")
    ]
    used = {line.split()[1] for line in lines}
    assert used == {"fit", "show", "eval", "decompose", "export", "convert", "render", "plot", "compare"}
    (tmp_path / "paint.binary").hardlink_to(folder / "paint.binary")  # the one file to be fitted
    # Smaller pictures for the fit of a MaterialX surface, which has tests of its own.
    monkeypatch.setattr(materialx, "_FIT_SIZES", dict.fromkeys(materialx._FIT_SIZES, 8))
    monkeypatch.chdir(tmp_path)
    shown = [run_main(cli.main, *words_of(line)) for line in lines]
    assert [answer.returncode for answer in shown] == [0] * len(lines)
    assert "relative_rms" in shown[0].stdout


@pytest.mark.usefixtures("python_quick_start")
def test_the_http_quick_start_with_curl(service: str, folder: Path) -> None:
    (text,) = blocks("sh", http=True)
    out = run_shell(text.replace(ADDRESS, service), folder)
    assert '"values"' in out
    assert all(label in out for label in LABELS)


@pytest.mark.usefixtures("python_quick_start")
def test_the_http_quick_start_with_httpx(service: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (text,) = blocks("python", http=True)
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    exec(compile(text.replace(ADDRESS, service), "README.md, httpx block", "exec"), names)
    assert len(names["answer"]["values"]) == 3
    assert names["fit"]["status"] == "succeeded"


def test_the_serve_command_starts_the_service_and_ends_with_it(tmp_path: Path) -> None:
    (line,) = [line for text in blocks("sh", http=False) for line in commands(text) if line.startswith("dsbrdf serve")]
    words = line.split()
    port = words.index("--port") + 1
    words[port] = "0"
    command = [sys.executable, "-m", "dsbrdf.cli.main", *words[1:]]
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(command, cwd=tmp_path, stdout=log, stderr=subprocess.STDOUT)
    try:
        url = printed_address(process, tmp_path / "log")
        assert httpx.get(f"{url}/health/ready", timeout=30).json()["status"] == "ready"
        assert (tmp_path / Settings().data_dir).is_dir()
    finally:
        stop(process)
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{url}/health/live", timeout=5)


def printed_address(process: "subprocess.Popen[bytes]", log: Path) -> str:
    deadline = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < deadline:
        if found := re.search(r"http://[\d.]+:\d+", log.read_text()):
            return found[0]
        time.sleep(0.05)
    raise AssertionError(f"the service said no address: {log.read_text()}")


@pytest.mark.usefixtures("python_quick_start")
def test_the_command_line_gives_components_in_the_form_of_the_service(service: str, folder: Path) -> None:
    content = (folder / "paint.binary").read_bytes()
    with httpx.Client(base_url=service, timeout=60) as client:
        fit = client.post("/v1/fits", content=content, headers={"Content-Type": "application/octet-stream"}).json()
        wire = client.get(f"/v1/fits/{fit['id']}/lobes").json()
    assert httpx.Response(200, text=run_shell("dsbrdf decompose paint.json --json", folder)).json() == wire


def test_the_targets_of_make_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    documents = README + (ROOT / "CONTRIBUTING.md").read_text()
    assert set(re.findall(r"(?:^|`)make ([a-z]+)", documents, re.MULTILINE)) <= targets
    assert {"demo", "serve", "test", "check", "fix", "bench", "lock"} <= targets


def test_readme_lists_the_extras_of_the_package() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    table = README.partition("| extra | brings |")[2].partition("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)`", table, re.MULTILINE)) == set(extras)


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_to_files_lead_somewhere(name: str) -> None:
    links = re.findall(r"\]\(([^)]+)\)", (ROOT / name).read_text())
    assert [link for link in links if "://" not in link and not (ROOT / link.partition("#")[0]).exists()] == []


def test_links_within_the_readme_lead_to_a_heading() -> None:
    headings = {
        re.sub(r"[^\w -]", "", text.lower()).replace(" ", "-") for text in re.findall(r"^#+ (.*)$", README, re.M)
    }
    anchors = set(re.findall(r"\]\(#([^)]+)\)", README))
    assert len(anchors) > 5
    assert anchors - headings == set()


PARAMETERS = ("amplitude", "kappa", "gamma", "center", "elongation", "delta")


def test_readme_glossary_names_all_metrics(python_quick_start: dict[str, Any]) -> None:
    glossary = README.partition("## Glossary")[2].partition("\n## ")[0]
    for name in (*METRICS, *PARAMETERS, "lobe", "n_lobes", "mask"):
        assert f"`{name}`" in glossary
