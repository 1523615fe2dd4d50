"""What the commands share: a parser that reports errors in one sentence, types of arguments, and output.

Imports nothing that takes time, so that commands which compute nothing answer at once.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

BAD_INPUT = 2
"""Exit code for bad usage and bad input."""


class Parser(argparse.ArgumentParser):
    """Reports a usage error in one sentence instead of printing the whole usage."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong and exit."""
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``, which every command with output has."""
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of text")


def print_json(document: Any) -> None:
    """Print one JSON document in one line."""
    print(json.dumps(document, allow_nan=False))


def print_error(error: BaseException | str) -> None:
    """Print one sentence to stderr; an error of the operating system is reported with its file."""
    if isinstance(error, OSError) and error.filename is not None:
        error = f"{error.filename}: {error.strerror}"
    sys.stderr.write(f"dsbrdf: {error}\n")


def whole_number(text: str) -> int:
    """Argument type: an int."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a whole number, not {text!r}") from None


def join_directions(words: Sequence[str]) -> list[str]:
    """Join a direction to its flag with ``=``: argparse would take ``-0.5,0,0.9`` for a flag of its own."""
    joined = list(words)
    for flag in ("--omega-in", "--omega-out"):
        while flag in joined[:-1]:
            at = joined.index(flag)
            joined[at : at + 2] = [f"{flag}={joined[at + 1]}"]
    return joined
