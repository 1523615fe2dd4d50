"""Commands on the data folder of a service, beside a running server too; each module has a `main`.

`keys` adds, lists and revokes API keys; `purge` removes what is old; `doctor` checks what is stored.
Here is what they share: usage errors in one sentence, and which folder is meant. They import neither NumPy nor
pydantic nor FastAPI, so that they answer at once.
"""

import argparse
import os
from pathlib import Path

from dsbrdf.cli import arguments as cli
from service import DEFAULT_DATA_DIR


class Parser(cli.Parser):
    """The parser of ``dsbrdf`` with the options that several commands have."""

    def add_data_dir(self) -> None:
        """Add the flag that names the data folder."""
        self.add_argument("--data-dir", type=Path, metavar="DIR", help="the service's folder")

    def add_json(self) -> None:
        """Add the flag that asks for JSON."""
        cli.add_json_option(self)


def data_folder(arguments: argparse.Namespace) -> Path:
    """Return the data folder: that of the command line, of the environment, or the default one."""
    if arguments.data_dir is not None:
        return Path(arguments.data_dir)
    given = [value for name, value in os.environ.items() if name.upper() == "DSBRDF_DATA_DIR" and value]
    return Path(given[0] if given else DEFAULT_DATA_DIR)


def refuse(reason: str) -> int:
    """Say why the command cannot be run; return the exit code."""
    cli.print_error(reason)
    return cli.BAD_INPUT
