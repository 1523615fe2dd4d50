"""Commands on the data folder of a service, beside a running server too; each module has a `main`.

`keys` adds, lists and revokes API keys; `purge` removes what is old; `doctor` checks what is stored.
Here is what they share: which folder is meant, and errors in one sentence. They import neither NumPy nor pydantic nor
FastAPI, so that they answer at once.
"""

import argparse
import os
import sqlite3
from collections.abc import Callable
from pathlib import Path

from dsbrdf.cli.arguments import BAD_INPUT, print_error

from .. import DEFAULT_DATA_DIR
from ..errors import DataFolderError
from ..storage.database import FILE_NAME


def add_data_dir(parser: argparse.ArgumentParser) -> None:
    """Add the flag that names the data folder."""
    parser.add_argument("--data-dir", type=Path, metavar="DIR", help="the service's folder")


def run_in_folder(arguments: argparse.Namespace, work: Callable[[Path], int], *, existing: bool = True) -> int:
    """Call `work` with the data folder: that of the command line, of the environment, or the default one.

    Return the exit code; with `existing`, a folder that no service has made is refused.
    """
    given = [value for name, value in os.environ.items() if name.upper() == "DSBRDF_DATA_DIR" and value]
    folder: Path = arguments.data_dir or Path(given[0] if given else DEFAULT_DATA_DIR)
    try:
        if existing and not (folder / FILE_NAME).exists():
            return refuse(f"{folder} is no data folder of a service; --data-dir names one")
        return work(folder)
    except (DataFolderError, OSError) as error:
        return refuse(str(error))
    except sqlite3.Error as error:
        refuse(f"the database cannot be used: {error}")
        return 1


def refuse(reason: str) -> int:
    """Say why the command cannot be run; return the exit code."""
    print_error(reason)
    return BAD_INPUT
