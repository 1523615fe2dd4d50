"""Exports by the name of a file: its suffix tells the format."""

import os
from pathlib import Path

from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.decomposition import Component
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import FORMATS, export_model


def export(
    source: DSBRDF | Component | FitResult, path: str | os.PathLike[str], file_format: str | None = None
) -> None:
    """Write a model or a component to a file for another program, completely or not at all.

    Parameters
    ----------
    source : DSBRDF, Component or FitResult
    path : path-like
        Its suffix determines the format: ``.json``, ``.npz``, ``.binary`` (MERL), ``.glsl``, ``.brdf``, ``.csv``,
        ``.bsdf`` (Mitsuba 3) or ``.mtlx`` (MaterialX).
    file_format : str, optional
        One of `dsbrdf.output.export.FORMATS`, whatever the suffix; ``bsdf-spectral`` can be had only so.

    Raises
    ------
    InvalidArgumentError
        If the suffix or the format is unknown, or the format cannot hold the source.
    MeasurementFormatError
        If a value of the model cannot be stored in a table.
    OSError
        If the file cannot be written.
    """
    chosen = format_of(path) if file_format is None else file_format
    model, report = (source.model, source.report) if isinstance(source, FitResult) else (source, None)
    write_atomically(path, [export_model(model, chosen, report)])


def format_of(path: str | os.PathLike[str]) -> str:
    """Return the name of the format that a file's suffix tells; an InvalidArgumentError lists the suffixes."""
    suffix = Path(path).suffix.lower().removeprefix(".")
    names = [name for name, kind in FORMATS.items() if kind.suffix == suffix]
    if not names:
        known = ", ".join(dict.fromkeys(f".{kind.suffix}" for kind in FORMATS.values()))
        raise InvalidArgumentError(f"{path}: the file must end in one of {known}, or the format must be named")
    return names[0]
