import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import dsbrdf
from dsbrdf import extras
from dsbrdf.cli import main as cli
from dsbrdf.cli.arguments import SERVICE_COMMANDS
from dsbrdf.cli.commands import command_names
from tests.support.command_line import QUICK, Capture, printed, run, sentence
from tests.support.commands import start_in_vain


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
    monkeypatch.setattr("dsbrdf.cli.commands.run_command", lambda _: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        cli.main(["show"])


def test_version_is_printed() -> None:
    assert printed("--version") == f"dsbrdf {dsbrdf.__version__}\n"


def test_fit_asks_for_one_blas_thread_before_numpy_is_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dsbrdf.cli.commands.run_command", lambda _: int(os.environ["OMP_NUM_THREADS"]))
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delitem(sys.modules, "numpy")
    run("fit", "none.binary", code=1)


def test_commands_that_compute_nothing_import_no_numpy() -> None:
    """NumPy and SciPy would take most of the time of such a command; the version needs no extra either."""
    program = """
import sys
from dsbrdf.cli.main import main
for words in ["--version"], ["--help"], ["keys", "--help"], ["purge", "--help"]:
    main(words)
    print(words, sorted({"numpy", "scipy", *["cyclopts", "rich"] * (words == ["--version"])} & {*sys.modules}))
"""
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert re.findall(r"^\['.*(\[.*\])$", answer.stdout, re.MULTILINE) == ["[]"] * 4


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


def test_help_of_serve_names_the_defaults(tmp_path: Path) -> None:
    code, text = start_in_vain(tmp_path, "--help")
    assert code == 0
    words = " ".join(text.split())
    assert "Default: one for each core." in words
    assert "Default: 127.0.0.1." in words


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


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_options_and_files(shell: str, tmp_path: Path) -> None:
    text, script = printed("completion", shell), tmp_path / "completion.sh"
    assert all(word in text for word in ("compare", "serve", "n-lobes", "theta-half", "specular_spike"))
    if shell == "bash":
        script.write_text(text)
        ask = f"source '{script}'; COMP_WORDS=(dsbrdf comp); COMP_CWORD=1; _dsbrdf; echo ${{COMPREPLY[@]}}"
        answer = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True)
        assert answer.stdout.split() == ["completion", "compare"]
