"""Export models and components to other programs: a table of formats, and a module for each format.

An example beside an exported file is a scene, a page or a script that shows the material on a sphere under lights. In
its template, ``FILE`` stands for the name of the exported file, and ``SELF`` for the name of the example.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from json import dumps
from pathlib import Path
from typing import Any, Literal, NamedTuple

from dsbrdf.components.component import Component
from dsbrdf.components.decomposition import decompose
from dsbrdf.components.layers import LayeredModel
from dsbrdf.components.shares import LABELS
from dsbrdf.data.files import write_atomically
from dsbrdf.data.merl import encode_merl
from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import RenderableModel
from dsbrdf.output.documents import component_documents, component_rows, table_csv
from dsbrdf.output.export.formula import python_file
from dsbrdf.output.export.glsl import NAME, glsl_function
from dsbrdf.output.export.materialx import materialx_document
from dsbrdf.output.export.rgl import rgl_bsdf
from dsbrdf.output.export.templates import filled, template
from dsbrdf.output.report_text import layers_csv, parameters_csv
from dsbrdf.output.serialize import layers_to_json, to_json
from dsbrdf.result import FitReport, FitResult

LAYERS = "layers"
"""Name of the part of a model that consists of the physical layers of all components."""
PARTS = (*LABELS, LAYERS)
"""Names of the parts of a model that can be exported alone."""


class Extras(NamedTuple):
    """Optional inputs that only some formats use."""

    report: FitReport | None
    name: str
    sampling: bool
    title: str


@dataclass(frozen=True)
class ExportFormat:
    """Describe a file format and its encoder."""

    purpose: str  # phrase on what the format is for, shown on the command line, in the HTTP reference and on the page
    suffix: str  # suffix of the file's name, without the dot
    media_type: str  # MIME type for HTTP
    encode: Callable[[Any, Extras], bytes | str]  # function from a model, layers or a component to a file's content
    holds_parameters: bool = False  # whether the format stores parameters, which a single component does not have
    needs_values_only: bool = False  # whether it also takes models without parameters, such as blends and functions
    time: Literal["short", "medium", "long"] = "short"  # duration of the encoding: about 50 ms, 1 s or several seconds


def _components(model: DSBRDF | LayeredModel, extras: Extras) -> bytes:
    if isinstance(model, LayeredModel):
        raise InvalidArgumentError("a table of components needs the whole model: leave the component out")
    psnr = None if extras.report is None else extras.report.metrics.psnr
    return table_csv(component_rows(extras.title, component_documents(model), psnr))


_BINARY_TYPE = "application/octet-stream"
_TEXT_TYPE = "text/plain; charset=utf-8"
_CSV_TYPE = "text/csv; charset=utf-8"
FORMATS = {
    "json": ExportFormat(
        "all numbers without loss (a model with its report)",
        "json",
        "application/json",
        lambda m, extras: layers_to_json(m) if isinstance(m, LayeredModel) else to_json(m, extras.report),
        holds_parameters=True,
    ),
    "merl": ExportFormat(
        "a table of values in the MERL format (35 MB)",
        "binary",
        _BINARY_TYPE,
        lambda source, _: encode_merl(source.tabulate()),
        needs_values_only=True,
        time="medium",
    ),
    "glsl": ExportFormat(
        "a function for shaders",
        "glsl",
        _TEXT_TYPE,
        lambda source, extras: glsl_function(source, extras.name, sampling=extras.sampling),
    ),
    "python": ExportFormat(
        "a differentiable function for NumPy, PyTorch and JAX",
        "py",
        "text/x-python; charset=utf-8",
        lambda source, _: python_file(source),
    ),
    "brdf": ExportFormat(
        "a function for Disney's BRDF Explorer",
        "brdf",
        _TEXT_TYPE,
        lambda source, _: filled(template("explorer.brdf"), {"FUNCTION": glsl_function(source)}),
    ),
    "csv": ExportFormat(
        "a table of the parameters",
        "csv",
        _CSV_TYPE,
        lambda model, _: layers_csv(model) if isinstance(model, LayeredModel) else parameters_csv(model),
        holds_parameters=True,
    ),
    "components": ExportFormat(
        "a table of the components (light, alpha, tail exponent, F0, F70, albedo and their ranges)",
        "csv",
        _CSV_TYPE,
        _components,
        holds_parameters=True,
    ),
    "bsdf": ExportFormat(
        "a table of values for Mitsuba 3",
        "bsdf",
        _BINARY_TYPE,
        lambda source, _: rgl_bsdf(source),
        needs_values_only=True,
        time="medium",
    ),
    "bsdf-spectral": ExportFormat(
        "a table of spectra for pbrt-v4 and spectral variants of Mitsuba 3",
        "bsdf",
        _BINARY_TYPE,
        lambda source, _: rgl_bsdf(source, spectral=True),
        needs_values_only=True,
        time="medium",
    ),
    "materialx": ExportFormat(
        "a similar OpenPBR surface (takes some seconds)",
        "mtlx",
        "application/xml",
        lambda model, extras: materialx_document(model, extras.title),
        holds_parameters=True,
        time="long",
    ),
}
"""Export formats by name; a new format needs a row in this table and a module of its own."""


def part_of(model: DSBRDF, part: str | None) -> DSBRDF | Component | LayeredModel:
    """Return a model's component, its layers or, for None, the model itself.

    Raises InvalidArgumentError if the model has no such component.
    """
    if part is None:
        return model
    return decompose(model).layers if part == LAYERS else decompose(model)[part]


def export_model(
    source: RenderableModel | Component,
    file_format: str,
    report: FitReport | None = None,
    *,
    name: str | None = None,
    sampling: bool = False,
    title: str = NAME,
) -> bytes:
    """Return the content of a file with a model, layers or a component; `file_format` is one of `FORMATS`.

    Only ``json`` stores the report; only ``glsl`` takes `name` and `sampling`, see `glsl_function`. The title names the
    material in ``materialx`` and ``components``. Raises InvalidArgumentError if the format is unknown, cannot hold a
    component, does not take an option or cannot store so large values, or if GLSL does not allow the name. Raises
    MeasurementFormatError if MERL cannot store a value.
    """
    if file_format not in FORMATS:
        raise InvalidArgumentError(f"the format must be one of {', '.join(FORMATS)}, not {file_format!r}")
    check_shader_options(file_format, name, sampling=sampling)
    if isinstance(source, Component):
        check_holds_component(file_format)
    elif not isinstance(source, DSBRDF | LayeredModel) and not FORMATS[file_format].needs_values_only:
        able = [name for name, kind in FORMATS.items() if kind.needs_values_only]
        raise InvalidArgumentError(
            f"the format {file_format} cannot contain a {type(source).__name__}, which has no parameters: "
            f"use {one_of(able)}"
        )
    content = FORMATS[file_format].encode(source, Extras(report, NAME if name is None else name, sampling, title))
    return content.encode() if isinstance(content, str) else content


def check_shader_options(file_format: str, name: str | None, *, sampling: bool) -> None:
    """Raise InvalidArgumentError if `name` or `sampling` is set for a format other than ``glsl``."""
    if (name is not None or sampling) and file_format != "glsl":
        raise InvalidArgumentError(f"name and sampling are options of the format glsl, not of {file_format}")


def check_holds_component(file_format: str) -> None:
    """Raise InvalidArgumentError if a format cannot hold a component."""
    if FORMATS[file_format].holds_parameters:
        able = [name for name, kind in FORMATS.items() if not kind.holds_parameters]
        raise InvalidArgumentError(
            f"the format {file_format} cannot contain a single component: use {one_of(able)}, or export the layers, a "
            "small model of all components"
        )


def export(
    source: RenderableModel | Component | FitResult,
    path: str | os.PathLike[str],
    file_format: str = "auto",
    *,
    name: str | None = None,
    sampling: bool = False,
) -> None:
    """Write a model, layers or a component to a file for another program; after an error, no partial file is left.

    Parameters
    ----------
    source : DSBRDF, LayeredModel, Component, FitResult or another model
        A model without parameters, such as a blend, can be written as a table of values only.
    path : path-like
        The file; its suffix is ``.json``, ``.binary`` (MERL), ``.glsl``, ``.py``, ``.brdf``,
        ``.csv``, ``.bsdf`` (Mitsuba 3) or ``.mtlx`` (MaterialX).
    file_format : str, optional
        One of `dsbrdf.output.export.FORMATS`. "auto" takes the first format with the file's suffix; ``components`` and
        ``bsdf-spectral`` must be named, because another format has the same suffix.
    name : str, optional
        Name of the function in GLSL, by default ``dsbrdf``; all other names in the file begin with it.
    sampling : bool, optional
        Whether to add GLSL functions that draw directions and return their density.

    Raises
    ------
    InvalidArgumentError
        If the suffix or the format is unknown, or the format cannot hold the source or does not take an option.
    MeasurementFormatError
        If a value of the model cannot be stored in a table.
    OSError
        If the file cannot be written.
    """
    chosen = format_of(path) if file_format == "auto" else file_format
    model, report = (source.model, source.report) if isinstance(source, FitResult) else (source, None)
    title = Path(path).stem
    write_atomically(path, [export_model(model, chosen, report, name=name, sampling=sampling, title=title)])


def format_of(path: str | os.PathLike[str]) -> str:
    """Return the format that a file's suffix selects; raise InvalidArgumentError if the suffix is unknown."""
    suffix = Path(path).suffix.lower().removeprefix(".")
    names = [name for name, kind in FORMATS.items() if kind.suffix == suffix]
    if not names:
        known = ", ".join(dict.fromkeys(f".{kind.suffix}" for kind in FORMATS.values()))
        raise InvalidArgumentError(f"{path}: the file must end in one of {known}, or the format must be named")
    return names[0]


EXAMPLES = {
    "glsl": (".html", "three.html"),
    "bsdf": (".xml", "mitsuba.xml"),
    "bsdf-spectral": (".pbrt", "scene.pbrt"),
    "materialx": ("_blender.py", "blender.txt"),
}
"""For each exported format that has an example: the end of the example's file name, and the example's template."""


def example(path: Path, file_format: str, content: bytes, name: str) -> tuple[Path, bytes]:
    """Return the path and the text of an example that shows an exported file; `name` is the GLSL function in the file.

    Raises InvalidArgumentError if the format has no example.
    """
    if file_format not in EXAMPLES:
        raise InvalidArgumentError(f"there is an example for {one_of(list(EXAMPLES))}, not for {file_format}")
    end, file = EXAMPLES[file_format]
    beside = path.with_name(path.stem + end)
    words = {"SELF": beside.name, "STEM": path.stem, "FILE": path.name}
    is_markup, shader = end in (".html", ".xml"), content.decode() if file_format == "glsl" else ""
    quoted = {w: escape(one) if is_markup else dumps(one, ensure_ascii=False)[1:-1] for w, one in words.items()}
    return beside, filled(template(file), quoted | {"FUNCTION": name, "SHADER": shader}).encode()
