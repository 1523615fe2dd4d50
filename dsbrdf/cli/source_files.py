"""Files that commands read: models and measurements, with the file's name in front of an error."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dsbrdf.data.file_kinds import known_kind
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.measurement_files import read_measurement
from dsbrdf.data.sample_tables import TABLE_SUFFIXES
from dsbrdf.errors import DSBRDFError, InvalidArgumentError, ModelFormatError
from dsbrdf.fitting.decomposition import Component
from dsbrdf.fitting.report import FitReport
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import part_of
from dsbrdf.output.serialize import read_model_file

MEASUREMENTS = (".binary", ".bsdf", *TABLE_SUFFIXES)
"""Suffixes of measurements."""


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


def read_model(path: Path) -> tuple[DSBRDF, FitReport | None]:
    """Read a model (``.json`` or ``.npz``) and its report, if any; an error names the file and what it is instead."""
    with named_in_errors(path):
        if path.suffix.lower() in MEASUREMENTS:
            raise InvalidArgumentError(
                "this command reads models, not measurements; fit it first with dsbrdf fit -o DIR"
            )
        with path.open("rb") as file:
            kind = known_kind(file.read(16))
        if kind is not None and not kind.startswith(("JSON", "a ZIP")):
            raise ModelFormatError(f"the file is {kind}; a stored model is a .json or .npz file")
        return read_model_file(path)


def named_part(path: Path, model: DSBRDF, part: str | None) -> DSBRDF | Component:
    """Return a part of the model in a file, see `part_of`; an error names the file."""
    with named_in_errors(path):
        return part_of(model, part)


def read_source(path: Path) -> Measurement | DSBRDF:
    """Read a measurement on the grid, or a model (``.json`` or ``.npz``); an error names the file."""
    return read_grid(path) if path.suffix.lower() in MEASUREMENTS else read_model(path)[0]
