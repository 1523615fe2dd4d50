"""Progress on a terminal."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dsbrdf.cli import main as cli
from tests.support.command_line import QUICK, Capture


def test_progress_goes_to_a_terminal_only(
    plastic_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture, terminal: Callable[[], None]
) -> None:
    assert cli.main(["fit", str(plastic_file), "--json", *QUICK]) == 0
    assert capsys.readouterr().err == ""
    terminal()
    assert cli.main(["fit", str(plastic_file), "--json", *QUICK]) == 0
    captured = capsys.readouterr()
    assert "1/1 files" in captured.err
    assert json.loads(captured.out)["status"] == "succeeded"
    assert cli.main(["fit", str(plastic_file), *QUICK]) == 0
    assert capsys.readouterr().out.startswith("plastic: far off")


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Call it to make stderr look like a terminal."""

    def pretend() -> None:
        monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)

    return pretend
