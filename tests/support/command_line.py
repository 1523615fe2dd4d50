"""The command ``dsbrdf``, called without a process of its own, and the service started to be refused."""

import io
import json
import os
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any
from unittest.mock import patch

import pytest

import dsbrdf
from dsbrdf.cli import main as cli
from tests.support.launcher import launcher

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
    found = dsbrdf.load(path)
    assert isinstance(found, dsbrdf.FitResult)
    return found


def run_main(main: Callable[[Sequence[str]], int], *words: str, **environment: str) -> "CompletedProcess[str]":
    """Call the main function of a command; the exit code is that of its process."""
    output, errors = io.StringIO(), io.StringIO()
    with redirect_stdout(output), redirect_stderr(errors), patch.dict(os.environ, environment):
        code = main(words)
    return CompletedProcess(words, code, output.getvalue(), errors.getvalue())


def start_in_vain(folder: Path, *arguments: str, **environment: str) -> tuple[int, str]:
    """Start a service that refuses to run; return its exit code and all that it printed."""
    log = folder / "refused.log"
    process = launcher("dsbrdf_service").launch(arguments, {**os.environ, **environment}, log)
    try:
        code = process.wait(60)
    finally:
        process.send_signal(9)
    text = log.read_text()
    log.unlink()
    return code, text
