"""Files that commands read: models and measurements, with the file's name in front of an error."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import read_merl
from dsbrdf.errors import DSBRDFError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.serialize import load


@contextmanager
def named_in_errors(path: Path) -> Iterator[None]:
    """Put the name of a file in front of the message of an error."""
    try:
        yield
    except DSBRDFError as error:
        raise type(error)(f"{path}: {error}") from error


def read_source(path: Path) -> Measurement | DSBRDF:
    """Read a measurement (``.binary``) or a model (``.json``, ``.npz``); an error names the file."""
    with named_in_errors(path):
        return read_merl(path) if path.suffix.lower() == ".binary" else load(path)
