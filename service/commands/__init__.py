"""Commands on the data folder of a service, beside a running server too; each module has a `main`.

`keys` adds, lists and revokes API keys; `purge` removes what is old; `doctor` checks installation and data folder.
Here is what they share: usage errors in one sentence, and which folder is meant. `keys` and `purge` import neither
NumPy nor pydantic nor FastAPI, so that they answer at once.
"""

import argparse
import os
import sys
from pathlib import Path
from typing import NoReturn

from service import DEFAULT_DATA_DIR

BAD_INPUT = 2


class Parser(argparse.ArgumentParser):
    """A parser that says in one sentence what is wrong, instead of printing the whole usage."""

    def error(self, message: str) -> NoReturn:
        """Print the sentence and exit."""
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")

    def add_data_dir(self) -> None:
        """Add the flag that names the data folder."""
        self.add_argument("--data-dir", type=Path, metavar="DIR", help="the service's folder")

    def add_json(self) -> None:
        """Add the flag that asks for JSON."""
        self.add_argument("--json", action="store_true", help="print one JSON document instead of text")


def data_folder(arguments: argparse.Namespace) -> Path:
    """Return the data folder: that of the command line, of the environment, or the default one."""
    if arguments.data_dir is not None:
        return Path(arguments.data_dir)
    given = [value for name, value in os.environ.items() if name.upper() == "DSBRDF_DATA_DIR" and value]
    return Path(given[0] if given else DEFAULT_DATA_DIR)


def refuse(reason: str) -> int:
    """Say why the command cannot be run; return the exit code."""
    sys.stderr.write(f"dsbrdf: {reason}\n")
    return BAD_INPUT
