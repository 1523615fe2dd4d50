"""Find the data folder of a command, and report the errors of commands that work on a folder."""

import os
import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from dsbrdf.cli.arguments import BAD_INPUT, print_error
from dsbrdf.cli.commands import run_words

from .. import DEFAULT_DATA_DIR
from ..errors import DataFolderError
from ..storage.database import is_data_folder

DataDir = Annotated[Path | None, Parameter(metavar="DIR", help="The service's folder.")]
Json = Annotated[bool, Parameter(help="Print one JSON document instead of text.")]


def data_folder(given: Path | None, *, existing: bool = True) -> Path:
    """Return the given data folder, or the folder in ``DSBRDF_DATA_DIR``, or the default folder.

    Raises DataFolderError if an `existing` folder is needed, but no service has made the folder.
    """
    folder = given or Path(os.environ.get("DSBRDF_DATA_DIR") or DEFAULT_DATA_DIR)
    if existing and not is_data_folder(folder):
        raise DataFolderError(f"{folder} is no data folder of a service; --data-dir names one")
    return folder


def run_on_folder(app: App, words: Sequence[str]) -> int:
    """Run a command that uses a data folder, with the arguments `words`; report its errors and return the exit code."""
    try:
        return run_words(app, words)
    except BrokenPipeError:  # The caller handles the early end of the program that reads the output.
        raise
    except (DataFolderError, OSError) as error:
        return refuse(str(error))
    except sqlite3.Error as error:
        refuse(f"the database cannot be used: {error}")
        return 1


def refuse(reason: str) -> int:
    """Print why the command cannot be run; return the exit code."""
    print_error(reason)
    return BAD_INPUT
