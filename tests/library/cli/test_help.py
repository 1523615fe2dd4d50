"""``--help``: of every command, on a terminal and in a file."""

import pytest

from dsbrdf.cli import main as cli
from dsbrdf.cli.arguments import SERVICE_COMMANDS
from dsbrdf.cli.commands import command_names
from tests.support.command_line import Capture


@pytest.mark.parametrize("command", command_names())
@pytest.mark.parametrize(("columns", "widest"), [("80", 80), ("200", 100)])
def test_help_is_plain_text_in_a_file(
    command: str, columns: str, widest: int, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    assert cli.main([command, "--help"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"Usage: dsbrdf {command}")
    assert max(map(len, out.splitlines())) <= widest
    assert "\x1b" not in out
    assert out.isascii()


def test_help_lists_all_commands_in_groups(capsys: Capture) -> None:
    assert cli.main(["--help"]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert {"Models", "Pictures", "Files", "Service", "Options"} <= {*lines}
    listed = {line.split()[0] for line in lines if line}
    assert listed >= {*command_names(), *SERVICE_COMMANDS, "--help", "--version"}


def test_help_has_colours_on_a_terminal_unless_they_are_not_wanted(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")  # a terminal, as far as rich knows
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert cli.main(["eval", "--help"]) == 0
    assert "\x1b[36m" in capsys.readouterr().out  # cyan
    monkeypatch.setenv("NO_COLOR", "1")
    assert cli.main(["eval", "--help"]) == 0
    assert "\x1b[36m" not in capsys.readouterr().out
