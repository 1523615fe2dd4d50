import json
import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

import dsbrdf
from dsbrdf import extras
from dsbrdf.cli import main as cli
from dsbrdf.cli.arguments import SERVICE_COMMANDS
from dsbrdf.cli.commands import command_names
from tests.support.command_line import QUICK, Capture, printed, sentence

# serve, demo, and the command itself


@pytest.mark.parametrize(
    ("command", "missing", "extra"),
    [
        ("serve", "fastapi", "service"),
        ("fit a.binary", "cyclopts", "cli"),
        ("--help", "cyclopts", "cli"),
        ("fit a.binary --url http://host", "httpx", "client"),
    ],
)
def test_missing_extra_is_named(command: str, missing: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == missing else name)
    assert f"pip install 'dsbrdf[{extra}]'" in sentence(*command.split(), code=1)


def test_internal_error_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dsbrdf.cli.commands.run_command", Mock(side_effect=ZeroDivisionError))
    with pytest.raises(ZeroDivisionError):
        cli.main(["show"])


def test_version_is_printed() -> None:
    assert printed("--version") == f"dsbrdf {dsbrdf.__version__}\n"


def test_fit_computes_with_one_blas_thread_from_the_start() -> None:
    program = "import atexit, os\nfrom dsbrdf.cli.main import main\n"
    program += "atexit.register(lambda: print(os.environ['OMP_NUM_THREADS']))\nmain(['fit', 'none.binary'])"
    environment = os.environ | {"OMP_NUM_THREADS": "7"}
    answer = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert answer.stdout == "1\n"


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["keys", "--help"], ["purge", "--help"]])
def test_command_that_computes_nothing_imports_no_numpy(words: list[str]) -> None:
    """NumPy and SciPy would take most of the time of such a command."""
    program = "import atexit, sys\nfrom dsbrdf.cli.main import main\n"
    program += "atexit.register(lambda: print(sorted({'numpy', 'scipy'} & {*sys.modules})))\nsys.exit(main())"
    answer = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, check=True)
    assert answer.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("command", command_names())
@pytest.mark.parametrize(("columns", "widest"), [("80", 80), ("200", 100)])
def test_help_is_plain_text_in_a_file(command: str, columns: str, widest: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    out = printed(command, "--help")
    assert out.startswith(f"Usage: dsbrdf {command}")
    assert max(map(len, out.splitlines())) <= widest
    assert "\x1b" not in out
    assert out.isascii()
    assert "[default: False]" not in out


def test_help_lists_all_commands_in_groups() -> None:
    lines = [line.strip() for line in printed("--help").splitlines()]
    assert {"Models", "Pictures", "Files", "Service", "Options"} <= {*lines}
    listed = {line.split()[0] for line in lines if line}
    assert listed >= {*command_names(), *SERVICE_COMMANDS, "--help", "--version"}


def test_help_has_colours_on_a_terminal_unless_they_are_not_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")  # a terminal, as far as rich knows
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert "\x1b[36m" in printed("eval", "--help")  # cyan
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b[36m" not in printed("eval", "--help")


def test_progress_goes_to_a_terminal_only(plastic_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    for is_terminal in (False, True):
        monkeypatch.setattr(sys.stderr, "isatty", lambda known=is_terminal: known, raising=False)
        assert cli.main(["fit", str(plastic_file), "--json", *QUICK]) == 0
        captured = capsys.readouterr()
        assert "1/1 files" in captured.err if is_terminal else captured.err == ""
        assert json.loads(captured.out)["status"] == "succeeded"
