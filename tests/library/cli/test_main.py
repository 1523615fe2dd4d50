"""The command ``dsbrdf`` as a whole: versions, usage, extras, the service's commands."""

import os
import subprocess
import sys
from typing import NoReturn

import pytest

import dsbrdf
from dsbrdf import extras
from dsbrdf.cli import main as cli
from tests.support.command_line import Capture, exit_code, sentence

# serve, demo, and the command itself


def test_serve_replaces_its_process_by_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[list[str]] = []

    def execv(_: str, command: list[str]) -> NoReturn:
        calls.append(command)
        raise SystemExit

    monkeypatch.setattr(os, "execv", execv)
    exit_code(["serve"])
    exit_code(["serve", "--host", "::1", "--port", "81", "--data-dir", "d", "--workers", "3", "--insecure"])
    start = [sys.executable, "-m", "dsbrdf_service"]
    every = ["--host", "::1", "--port", "81", "--data-dir", "d", "--workers", "3", "--insecure"]
    assert calls == [start, start + every]


def test_service_accepts_the_flags_of_serve() -> None:
    answer = subprocess.run([sys.executable, "-m", "service", "--help"], capture_output=True, text=True, check=True)
    for flag in ("--host", "--port", "--data-dir", "--workers", "--insecure"):
        assert flag in answer.stdout


@pytest.mark.parametrize(
    ("command", "installed", "extra"),
    [("serve", (), "service"), ("fit", (), "cli"), ("--help", (), "cli")],
)
def test_missing_extra_is_named(
    command: str, installed: tuple[str, ...], extra: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: name in installed or None)
    assert cli.main([command]) == 1
    assert f"pip install 'dsbrdf[{extra}]'" in sentence(capsys)


def test_version_is_printed(capsys: Capture) -> None:
    assert exit_code(["--version"]) == 0
    assert capsys.readouterr().out == f"dsbrdf {dsbrdf.__version__}\n"


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["keys", "--help"], ["purge", "--help"]])
def test_command_that_computes_nothing_imports_no_numpy(words: list[str]) -> None:
    """NumPy and SciPy would take most of the time of such a command."""
    program = "import atexit, sys\nfrom dsbrdf.cli.main import main\n"
    program += "atexit.register(lambda: print(sorted({'numpy', 'scipy'} & {*sys.modules})))\nsys.exit(main())"
    answer = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, check=True)
    assert answer.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("words", [[], ["unknown"], ["fit"], ["eval"], ["export", "m.json"]])
def test_wrong_usage_is_refused_in_one_sentence(words: list[str], capsys: Capture) -> None:
    assert exit_code(words) == 2
    assert sentence(capsys).startswith("dsbrdf")
