"""What a command printed, and how it ended."""

import json
from typing import Any

import pytest

from dsbrdf.cli import main as cli

Capture = pytest.CaptureFixture[str]

QUICK = ("--method", "paper", "--n-lobes", "1", "--em-iterations", "40")
FEW_LOBES = ("--n-lobes", "2", "--ring-lobes", "0")


def document(capture: Capture) -> Any:
    out = capture.readouterr().out
    assert out.count("\n") == 1
    return json.loads(out)


def sentence(capture: Capture) -> str:
    """The one line on stderr of a command that printed nothing else."""
    captured = capture.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


def exit_code(argv: list[str]) -> int:
    """What the process would end with, whether argparse ended it or the command returned."""
    try:
        return cli.main(argv)
    except SystemExit as end:
        return int(end.code or 0)
