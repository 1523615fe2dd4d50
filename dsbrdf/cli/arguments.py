"""Define functions that all commands use: for output, errors, flags with lists, and the commands of the service.

This module imports no slow module, so that commands that compute nothing answer at once.
"""

import json
import os
import re
import sys
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from dsbrdf.extras import require

BAD_INPUT = 2
"""Exit code for bad usage and bad input."""

LIST_FLAGS = (
    *("--theta-half", "--theta-diff", "--phi-diff"),
    *("--theta-in", "--theta-out", "--phi-out"),
    *("--omega-in", "--omega-out", "--knots-deg", "--missing"),
)
"""Flags that take several values, separated by blanks or commas; a direction contains commas, so only blanks count."""

_NUMBERS = re.compile(r"[-+]?[0-9.][-+0-9.e, ]*")


def print_json(document: Any) -> None:
    """Print a JSON document in one line."""
    print(json.dumps(document, allow_nan=False))


def print_error(error: BaseException | str) -> None:
    """Print one sentence to stderr; for a system error with a file, the sentence names this file."""
    if isinstance(error, OSError) and error.strerror:
        error = error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    sys.stderr.write(f"dsbrdf: {error}\n")


def print_written(path: Path, what: str, file_format: str = "", *, json: bool = False, **about: Any) -> None:
    """Print the name, kind and size of a written file; JSON also contains the values in `about`."""
    size = path.stat().st_size
    if json:
        print_json({"output": str(path), "format": file_format, "bytes": size} | about)
        return
    amount = f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{max(size / 1e3, 0.1):.3g} kB"
    print(f"{path}: {what} ({amount})")


def join_points(words: Sequence[str]) -> list[str]:
    """Join each flag of a list with its numbers: ``--theta-half 0 10 m.json`` becomes ``"--theta-half=0 10" m.json``.

    Without joining, cyclopts would read ``m.json`` as one more angle, and ``-0.5,0,0.9`` as a flag.
    """
    joined: list[str] = []
    flag = ""
    for word in words:
        if flag and _NUMBERS.fullmatch(word):
            joined[-1] += f"{'=' if joined[-1] == flag else ' '}{word}"
        else:
            flag = word if word in LIST_FLAGS else ""
            joined.append(word)
    return joined


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a question that suggests known words similar to ``word``; empty if no word is similar."""
    near = get_close_matches(word, list(known), n=2, cutoff=0.6)
    return f"; did you mean {' or '.join(near)}?" if near else ""


# For each command of the service, this has the modules that must be installed, and a sentence for the help.
SERVICE_COMMANDS = {
    "serve": (("cyclopts", "fastapi", "pydantic_settings", "uvicorn"), "Run the HTTP service."),
    "keys": (("cyclopts", "pydantic_settings"), "Add, list and revoke API keys of the service."),
    "purge": (("cyclopts", "pydantic_settings"), "Remove old fits and measurements of the service."),
    "doctor": (("cyclopts", "pydantic_settings"), "Check the service's database and stored files."),
}


def entry_point(group: str, name: str) -> EntryPoint:
    """Return the entry point of a command or an engine of the service, which ``pyproject.toml`` declares."""
    (found,) = entry_points(group=f"dsbrdf.{group}", name=name)
    return found


def prepare_output() -> None:
    """Replace a closed stdout or stderr by the null device, and escape characters that stdout cannot encode.

    Without a replacement, a file that is opened later could get the descriptor.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 (until the end)
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors in ("strict", "surrogateescape"):
        sys.stdout.reconfigure(errors="backslashreplace")


def run_service_command(command: str, words: Sequence[str]) -> int:
    """Run one of `SERVICE_COMMANDS` with the arguments that follow it; return the exit code.

    Raises MissingExtraError if the service is not installed.
    """
    needed, _ = SERVICE_COMMANDS[command]
    require("service", *needed, purpose="the HTTP service" if command == "serve" else f"dsbrdf {command}")
    found = entry_point("commands", command)
    if command == "serve":  # The service replaces this process, so that signals to this process reach the service.
        sys.stdout.flush()
        os.execv(sys.executable, [sys.executable, "-m", found.module.removesuffix(".__main__"), *words])  # noqa: S606 (no shell)
    code: int = found.load()(words)
    return code
