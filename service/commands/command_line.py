"""What the commands on a data folder share: usage errors in one sentence, and which folder is meant."""

import argparse
import sys
from pathlib import Path
from typing import NoReturn

from service.settings import Settings

BAD_INPUT = 2


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one sentence instead of printing the whole usage."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, and exit."""
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")

    def add_common(self) -> None:
        """Add the flags that every command has."""
        self.add_argument("--data-dir", type=Path, metavar="DIR", help="the service's folder")
        self.add_argument("--json", action="store_true", help="print one JSON document instead of text")


def settings_of(arguments: argparse.Namespace) -> Settings:
    """Return the settings that a server would have, with the folder that the command line names.

    Raises
    ------
    pydantic.ValidationError
        If an environment variable is wrong.
    """
    return Settings() if arguments.data_dir is None else Settings(data_dir=arguments.data_dir)


def refuse(reason: str) -> int:
    """Say why the command cannot be run; return the exit code."""
    sys.stderr.write(f"dsbrdf: {reason}\n")
    return BAD_INPUT
