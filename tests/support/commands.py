"""Commands run without a process of their own, and the service started to be refused."""

import io
import os
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from subprocess import CompletedProcess
from unittest.mock import patch

from tests.support.launcher import launcher


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
