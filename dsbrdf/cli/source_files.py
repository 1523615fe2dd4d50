"""Files that commands read: models and measurements, with the file's name in front of an error."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.measurement_files import read_measurement
from dsbrdf.errors import DSBRDFError, InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.serialize import load


@contextmanager
def named_in_errors(path: Path) -> Iterator[None]:
    """Put the name of a file in front of the message of an error."""
    try:
        yield
    except DSBRDFError as error:
        raise type(error)(f"{path}: {error}") from error


def read_grid(path: Path) -> Measurement:
    """Read a measurement on the grid (``.binary`` or ``.bsdf``); an error names the file."""
    with named_in_errors(path):
        measurement = read_measurement(path)
        if not isinstance(measurement, Measurement):
            raise InvalidArgumentError("scattered samples are no measurement on a grid; fit them first")
        return measurement


def read_source(path: Path) -> Measurement | DSBRDF:
    """Read a measurement on the grid, or a model (``.json`` or ``.npz``); an error names the file."""
    if path.suffix.lower() in (".binary", ".bsdf", ".csv"):
        return read_grid(path)
    with named_in_errors(path):
        return load(path)
