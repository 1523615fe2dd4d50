"""The command ``dsbrdf``, called without a process of its own: what it prints, how it ends, and the fit it stores."""

import json
from collections.abc import Sequence
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest

import dsbrdf
from dsbrdf.cli import main as cli
from tests.support.commands import run_main

Capture = pytest.CaptureFixture[str]

QUICK = ("--method", "paper", "--n-lobes", "1", "--em-iterations", "40")
FEW_LOBES = ("--n-lobes", "2", "--ring-lobes", "0")


def run(*words: object, code: int = 0) -> "CompletedProcess[str]":
    """Return what a command printed that has ended with a code."""
    answer = run_main(_exit_code, *map(str, words))
    assert answer.returncode == code, answer.stderr
    return answer


def printed(*words: object) -> str:
    return run(*words).stdout


def document(*words: object, code: int = 0) -> Any:
    """The JSON document that a command printed in one line."""
    out = run(*words, code=code).stdout
    assert out.count("\n") == 1
    return json.loads(out)


def sentence(*words: object, code: int = 2) -> str:
    """The one line on stderr of a command that printed nothing else."""
    answer = run(*words, code=code)
    assert answer.stdout == ""
    assert answer.stderr.count("\n") == 1
    return answer.stderr


def _exit_code(words: Sequence[str]) -> int:
    """What the process would end with, whether the parser ended it or the command returned."""
    try:
        return cli.main(list(words))
    except SystemExit as end:
        return int(end.code or 0)


def load_fit(path: Path) -> dsbrdf.FitResult:
    """Return the fit in a file, which must have a report."""
    found = dsbrdf.load(path)
    assert isinstance(found, dsbrdf.FitResult)
    return found
