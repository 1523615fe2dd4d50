"""Models for other programs: one file here for each format that is not the library's own."""

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.report import FitReport
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export.merl_table import merl_table
from dsbrdf.output.serialize import to_json, to_npz

__all__ = ["FORMATS", "export_model", "merl_table"]

FORMATS = ("json", "npz", "merl")


def export_model(model: DSBRDF, file_format: str, report: FitReport | None = None) -> bytes:
    """Return the content of a file that holds a model.

    Parameters
    ----------
    model : DSBRDF
        A model, or one component of it.
    file_format : {"json", "npz", "merl"}
        ``json`` and ``npz`` hold the parameters without loss, ``merl`` a table of values.
    report : FitReport, optional
        Kept by ``json`` and ``npz``.

    Returns
    -------
    bytes

    Raises
    ------
    InvalidArgumentError
        If the format is unknown.
    MeasurementFormatError
        If the model's values do not fit into a table.
    """
    if file_format == "json":
        return to_json(model, report).encode()
    if file_format == "npz":
        return to_npz(model, report)
    if file_format == "merl":
        return merl_table(model)
    raise InvalidArgumentError(f"the format must be one of {', '.join(FORMATS)}, not {file_format!r}")
