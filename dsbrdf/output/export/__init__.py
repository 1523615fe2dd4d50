"""Models and components for other programs: a table of the formats, and one file for each that is not our own."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.decomposition import LABELS, Component, decompose
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
    "GUIDE",
    "PARTS",
    "ExportFormat",
    "brdf_explorer_file",
    "check_holds_component",
    "export_model",
    "glsl_function",
    "materialx_document",
    "merl_table",
    "parameters_csv",
    "part_of",
    "rgl_bsdf",
]


GUIDE = "guide"
"""Name of all components' own lobes together."""
PARTS = (*LABELS, GUIDE)
"""Names of parts of a model."""


@dataclass(frozen=True)
class ExportFormat:
    """One kind of file.

    Attributes
    ----------
    purpose : str
        What it is for, in a few words; command line, HTTP reference and page show it.
    suffix : str
        Of the file's name, without the dot.
    media_type : str
        For HTTP.
    purpose : str
        What the file is for, in a few words.
    encode : callable
        Returns the content of the file for a model and, if there is one, its report.
    encode_component : callable, optional
        Returns the content of the file for a component; None where the format holds lobes, which a component has not.
    time : {"short", "medium", "long"}, optional
        At most some 50 ms, about a second, or longer.
    """

    purpose: str
    suffix: str
    media_type: str
    encode: Callable[[DSBRDF, FitReport | None], bytes]
    encode_component: Callable[[Component], bytes] | None = None
    time: Literal["short", "medium", "long"] = "short"


def _of_values(
    purpose: str,
    suffix: str,
    media_type: str,
    encode: Callable[[DSBRDF | Component], bytes],
    time: Literal["short", "medium"] = "short",
) -> ExportFormat:
    """Return a format that holds values, of a model as well as of a component."""
    return ExportFormat(purpose, suffix, media_type, lambda model, _: encode(model), encode, time)


_BINARY, _TEXT = "application/octet-stream", "text/plain; charset=utf-8"
FORMATS = {
    "json": ExportFormat(
        "the model and its report, without loss",
        "json",
        "application/json",
        lambda model, report: to_json(model, report).encode(),
    ),
    "npz": ExportFormat("the model and its report for NumPy, without loss", "npz", _BINARY, to_npz),
    "merl": _of_values("a table of values in the MERL format, 35 MB", "binary", _BINARY, merl_table),
    "glsl": _of_values("a function for shaders", "glsl", _TEXT, lambda source: glsl_function(source).encode()),
    "brdf": _of_values("for Disney's BRDF Explorer", "brdf", _TEXT, lambda source: brdf_explorer_file(source).encode()),
    "csv": ExportFormat(
        "a table of the parameters",
        "csv",
        "text/csv; charset=utf-8",
        lambda model, _: parameters_csv(model).encode(),
    ),
    "bsdf": _of_values("for Mitsuba 3", "bsdf", _BINARY, rgl_bsdf, "medium"),
    "bsdf-spectral": _of_values(
        "for spectral variants of Mitsuba 3, and pbrt-v4",
        "bsdf",
        _BINARY,
        lambda source: rgl_bsdf(source, spectral=True),
        "medium",
    ),
    "materialx": ExportFormat(
        "the OpenPBR surface that looks most like it, which takes some seconds",
        "mtlx",
        "application/xml",
        lambda model, _: materialx_document(model).encode(),
        time="long",
    ),
}
"""Name -> format; a new one has a row here, and a file of its own."""


def part_of(model: DSBRDF, part: str | None) -> DSBRDF | Component:
    """Return a model's component, its guide or, for None, the model itself.

    Parameters
    ----------
    model : DSBRDF
    part : {"specular_spike", "specular_lobe", "diffuse", "guide"} or None

    Returns
    -------
    DSBRDF or Component

    Raises
    ------
    InvalidArgumentError
        If the model has no such component.
    """
    if part is None:
        return model
    return decompose(model).guide if part == GUIDE else decompose(model)[part]


def export_model(source: DSBRDF | Component, file_format: str, report: FitReport | None = None) -> bytes:
    """Return the content of a file with a model or a component.

    Parameters
    ----------
    source : DSBRDF or Component
    file_format : str
        A key of `FORMATS`, which says what each is for.
    report : FitReport, optional
        Stored by ``json`` and ``npz``.

    Returns
    -------
    bytes

    Raises
    ------
    InvalidArgumentError
        If the format is unknown or cannot hold a component, or the values are too large for it.
    MeasurementFormatError
        If a value of the model cannot be stored in a table.
    """
    if file_format not in FORMATS:
        raise InvalidArgumentError(f"the format must be one of {', '.join(FORMATS)}, not {file_format!r}")
    if isinstance(source, DSBRDF):
        return FORMATS[file_format].encode(source, report)
    return check_holds_component(file_format)(source)


def check_holds_component(file_format: str) -> Callable[[Component], bytes]:
    """Return what writes a component in a format; raise InvalidArgumentError if the format cannot hold one."""
    encode = FORMATS[file_format].encode_component
    if encode is None:
        able = [name for name, kind in FORMATS.items() if kind.encode_component]
        raise InvalidArgumentError(
            f"{file_format} cannot hold a component, whose values are a share of the model's: take "
            f"{', '.join(able[:-1])} or {able[-1]}, or export the guide, which is the components' own lobes together"
        )
    return encode
