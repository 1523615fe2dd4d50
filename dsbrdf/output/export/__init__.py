"""Models for other programs: a table of the formats, and one file for each that is not the library's own."""

from collections.abc import Callable
from dataclasses import dataclass

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.report import FitReport
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export.brdf_explorer import brdf_explorer_file
from dsbrdf.output.export.glsl import glsl_function
from dsbrdf.output.export.materialx import materialx_document
from dsbrdf.output.export.merl import merl_table
from dsbrdf.output.export.parameter_table import parameters_csv
from dsbrdf.output.export.rgl import rgl_bsdf
from dsbrdf.output.serialize import to_json, to_npz

__all__ = [
    "FORMATS",
    "ExportFormat",
    "brdf_explorer_file",
    "export_model",
    "glsl_function",
    "materialx_document",
    "merl_table",
    "parameters_csv",
    "rgl_bsdf",
]


@dataclass(frozen=True)
class ExportFormat:
    """One kind of file.

    Attributes
    ----------
    suffix : str
        Of the file's name, without the dot.
    media_type : str
        For HTTP.
    encode : callable
        Returns the content of the file for a model and, if there is one, its report.
    """

    suffix: str
    media_type: str
    encode: Callable[[DSBRDF, FitReport | None], bytes]


FORMATS = {
    "json": ExportFormat("json", "application/json", lambda model, report: to_json(model, report).encode()),
    "npz": ExportFormat("npz", "application/octet-stream", to_npz),
    "merl": ExportFormat("binary", "application/octet-stream", lambda model, _: merl_table(model)),
    "glsl": ExportFormat("glsl", "text/plain; charset=utf-8", lambda model, _: glsl_function(model).encode()),
    "brdf": ExportFormat("brdf", "text/plain; charset=utf-8", lambda model, _: brdf_explorer_file(model).encode()),
    "csv": ExportFormat("csv", "text/csv; charset=utf-8", lambda model, _: parameters_csv(model).encode()),
    "bsdf": ExportFormat("bsdf", "application/octet-stream", lambda model, _: rgl_bsdf(model)),
    "bsdf-spectral": ExportFormat("bsdf", "application/octet-stream", lambda model, _: rgl_bsdf(model, spectral=True)),
    "materialx": ExportFormat("mtlx", "application/xml", lambda model, _: materialx_document(model).encode()),
}


def export_model(model: DSBRDF, file_format: str, report: FitReport | None = None) -> bytes:
    """Return the content of a file with a model.

    Parameters
    ----------
    model : DSBRDF
        A model, or one component of it.
    file_format : {"json", "npz", "merl", "glsl", "brdf", "csv", "bsdf", "bsdf-spectral", "materialx"}
        ``json`` and ``npz`` store the parameters without loss, ``merl`` is a table of values, ``glsl`` a function for
        shaders, ``brdf`` the same for Disney's BRDF Explorer, ``csv`` a table of the parameters, ``bsdf`` a file of the
        RGL database for Mitsuba 3, ``bsdf-spectral`` one for pbrt-v4 and for spectral variants of Mitsuba,
        ``materialx`` the nearest OpenPBR surface, which takes some seconds.
    report : FitReport, optional
        Stored by ``json`` and ``npz``.

    Returns
    -------
    bytes

    Raises
    ------
    InvalidArgumentError
        If the format is unknown, or the values of the model are too large for it.
    MeasurementFormatError
        If a value of the model cannot be stored in a table.
    """
    if file_format not in FORMATS:
        raise InvalidArgumentError(f"the format must be one of {', '.join(FORMATS)}, not {file_format!r}")
    return FORMATS[file_format].encode(model, report)
