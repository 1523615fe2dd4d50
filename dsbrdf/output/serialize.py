"""Convert models and reports to versioned JSON and back, without loss.

A file contains the format ``dsbrdf``, a version, the arrays of a `DSBRDF` and, if there is one, the report of the fit.
Every number has enough digits to restore the same bits. All content is checked when a file is read, and damaged content
raises a `ModelFormatError`.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.component import Decomposition
from dsbrdf.components.description import Description
from dsbrdf.components.layers import LayeredModel
from dsbrdf.components.shares import LABELS, ComponentRanges, Range, WeightedLayers
from dsbrdf.data.files import write_atomically
from dsbrdf.errors import InvalidArgumentError, ModelFormatError
from dsbrdf.model.dsbrdf import DSBRDF, TEXTS
from dsbrdf.output.documents import component_document
from dsbrdf.result import FitReport, FitResult

FORMAT = "dsbrdf"
LAYERS_FORMAT = "dsbrdf-layers"
VERSION = 2
ARRAYS = tuple(field.name for field in fields(DSBRDF) if field.name not in TEXTS)
"""Names of the attributes of a `DSBRDF` that are arrays."""

_MAX_FILE_BYTES = 64 << 20  # A larger file is refused, because a model with its report has less than 1 MB.


def save(model: DSBRDF | FitResult, path: str | os.PathLike[str]) -> None:
    """Write a model, or a fit's model with its report, to a ``.json`` file.

    After an error, an existing file is unchanged and no partial file is left.

    Parameters
    ----------
    model : DSBRDF or FitResult
        The model or fit to write.
    path : path-like
        The file to write.

    Raises
    ------
    InvalidArgumentError
        If the suffix is not ``.json``, the object is neither a model nor a fit, or the report has a value that JSON
        cannot store.
    OSError
        If the file cannot be written.
    """
    plain, report = (model.model, model.report) if isinstance(model, FitResult) else (model, None)
    if not isinstance(plain, DSBRDF):
        raise InvalidArgumentError(
            f"a {type(plain).__name__} cannot be saved: save the model or its fit, or write a file with dsbrdf.export"
        )
    _check_suffix(path)
    write_atomically(path, [to_json(plain, report).encode()])


def load(path: str | os.PathLike[str]) -> DSBRDF | FitResult:
    """Read a fit or a model from a ``.json`` file that `save` wrote.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    FitResult or DSBRDF
        The model with the report of its fit, or the model alone if the file has no report. Functions such as `plot`,
        `decompose` and `export` take both.

    Raises
    ------
    ModelFormatError
        If the file is damaged, of another kind, or of another version.
    InvalidArgumentError
        If the suffix is not ``.json``.
    OSError
        If the file does not exist or cannot be read.
    """
    model, report = read_model_file(path)
    return model if report is None else FitResult(model, report)


def read_model_file(path: str | os.PathLike[str]) -> tuple[DSBRDF, FitReport | None]:
    """Read the model and the report, if any, from a ``.json`` file; raise the same errors as `load`."""
    _check_suffix(path)
    with Path(path).open("rb") as file:
        content = file.read(_MAX_FILE_BYTES + 1)
    if len(content) > _MAX_FILE_BYTES:
        raise ModelFormatError(f"The file is longer than the {_MAX_FILE_BYTES} bytes that a model may have.")
    try:
        text = content.decode()
    except UnicodeDecodeError:
        raise ModelFormatError("The file is not a JSON text in UTF-8, as a stored model must be.") from None
    return from_json(text)


def to_json(model: DSBRDF, report: FitReport | None = None, components: Decomposition | None = None) -> str:
    """Return a model and its report as JSON text.

    The text is ``{"format": "dsbrdf", "version": 2, "model": {...}, "report": {...} or null}``. If `components` are
    given, the text begins with ``warnings``, ``findings`` and ``measure_next`` of the report, the `component_document`
    of each component, and the ``structures`` of layers from which `fit_from_json` restores the components. Raises
    InvalidArgumentError if the report has a value that JSON cannot store, such as NaN.
    """
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "model": model_to_dict(model),
        "report": None if report is None else report.to_dict(),
    }
    if components is not None:
        findings = (*(report.findings_of_fit if report is not None else ()), *components.findings)
        document = {
            "warnings": [finding.sentence for finding in findings],
            "findings": [asdict(finding) for finding in findings],
            "measure_next": [] if report is None else document["report"]["measure_next"],
            "components": [component_document(component) for component in components],
            "structures": [asdict(structure) for structure in components.structures],
            "diffuse_range": components.diffuse_range,
            "alternatives": components.alternatives,
            **document,
        }
    return _dump(document)


def from_json(text: str) -> tuple[DSBRDF, FitReport | None]:
    """Return the model and the report, if any, of a JSON text; the inverse of `to_json`.

    Raises ModelFormatError if the text is damaged, not of the format ``dsbrdf``, or of another version.
    """
    return _parsed(text)[1:]


def fit_from_json(text: str) -> tuple[Decomposition, FitReport | None]:
    """Return the model with its components, and the report, if any, of a JSON text from `to_json`.

    Raises ModelFormatError if the text is damaged, or if its components are missing or inconsistent.
    """
    document, model, report = _parsed(text)
    try:
        parts = document["components"]
        labels = tuple(part["label"] for part in parts)
        ranges = tuple(_typed(ComponentRanges, part["ranges"], "ranges") for part in parts)
        described = [{name: part[name] for name in ("surfaces", "misfit", "layers")} for part in parts]
    except (KeyError, TypeError):
        raise ModelFormatError("The stored components are damaged, or there are none.") from None
    descriptions = tuple(
        _typed(Description, one | {"layers": {"layers": one["layers"]}}, "description") for one in described
    )
    if labels != tuple(label for label in LABELS if label in labels):
        raise ModelFormatError("The stored components are damaged: their order is wrong.")
    structures = _typed(tuple[WeightedLayers, ...], document.get("structures"), "structures")
    if any(len(one.is_diffuse) != len(one.model.layers) for one in structures):
        raise ModelFormatError("The stored structures are damaged: they do not say which layers are diffuse.")
    diffuse_range: Range = _typed(Range, document.get("diffuse_range"), "diffuse_range")
    alternatives = _typed(tuple[str, ...], document.get("alternatives"), "alternatives")
    return Decomposition(model, structures, labels, ranges, descriptions, diffuse_range, alternatives), report


def layers_to_json(layers: LayeredModel) -> str:
    """Return a layered model as JSON text: ``{"format": "dsbrdf-layers", "version": 2, "layers": [...]}``."""
    return _dump({"format": LAYERS_FORMAT, "version": VERSION, **asdict(layers)})


def result_from_json(text: str) -> FitResult:
    """Return the result of a fit from a JSON text; raise ModelFormatError if the text is damaged or has no report."""
    model, report = from_json(text)
    if report is None:
        raise ModelFormatError("The stored model has no report of a fit.")
    return FitResult(model, report)


def _check_suffix(path: str | os.PathLike[str]) -> None:
    if Path(path).suffix.lower() != ".json":
        raise InvalidArgumentError(
            f"A model's file must end in .json, unlike {Path(path).name!r}; dsbrdf.export writes other kinds."
        )


def _dump(content: object) -> str:
    try:
        return json.dumps(content, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError(f"The report must contain only plain, finite values: {error}.") from None


def _parsed(text: str) -> tuple[dict[str, Any], DSBRDF, FitReport | None]:
    """Return the document in a JSON text, whose format and version are checked, and its model and report."""
    try:
        document = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        if isinstance(error, ModelFormatError):
            raise
        raise ModelFormatError("The text is not valid JSON: it is damaged or cut off.") from None
    if not isinstance(document, dict):
        raise ModelFormatError("The JSON text is not an object, as a stored model must be.")
    if document.get("format") != FORMAT:
        raise ModelFormatError(f"The data is not a stored model: its format is not {FORMAT!r}.")
    version = document.get("version")
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise ModelFormatError(f"The stored model has no valid version; it must be {VERSION}.")
    if version != VERSION:
        raise ModelFormatError(f"The stored model has version {version}; this release reads version {VERSION}.")
    for key in ("model", "report"):
        if key not in document:
            raise ModelFormatError(f"The stored model lacks the key {key!r}.")
    report = document["report"]
    return document, model_from_dict(document["model"]), None if report is None else report_from_dict(report)


def _refuse_constant(constant: str) -> None:
    raise ModelFormatError(f"The stored model contains {constant}; every number must be finite.")


def model_to_dict(model: DSBRDF) -> dict[str, Any]:
    """Return a model as nested lists of numbers, keyed by the names of its attributes; angles in radians."""
    arrays = {name: getattr(model, name).tolist() for name in ARRAYS}
    return arrays | {name: getattr(model, name) for name in TEXTS}


def model_from_dict(content: Mapping[str, Any]) -> DSBRDF:
    """Return the model that nested lists or arrays describe; the inverse of `model_to_dict`.

    Raises ModelFormatError if a key is missing or unknown, or a value has the wrong shape, is not finite or out of
    range.
    """
    _check_keys("model", content, (*ARRAYS, *TEXTS))
    parameters: dict[str, Any] = {name: _numbers(name, content[name]) for name in ARRAYS}
    for name in TEXTS:
        if not isinstance(content[name], str):
            raise ModelFormatError(f"The {name} in the stored model is not a text.")
        parameters[name] = content[name]
    try:
        return DSBRDF(**parameters)
    except InvalidArgumentError as error:
        raise ModelFormatError(f"The stored model is not valid: {error}") from None


def report_from_dict(content: Mapping[str, Any]) -> FitReport:
    """Return the report that dicts and lists describe; the inverse of `FitReport.to_dict`.

    Raises ModelFormatError if a key is missing or unknown, a value is of the wrong kind, or the options are not valid.
    """
    try:
        return _typed(FitReport, content, "report")
    except InvalidArgumentError as error:
        raise ModelFormatError(f"The options in the stored report are not valid: {error}") from None


def _numbers(name: str, value: Any) -> Array:
    try:
        array = np.asarray(value)
    except ValueError:
        raise ModelFormatError(f"The stored model's {name} is not a regular array.") from None
    if array.dtype.kind not in "fi":
        raise ModelFormatError(f"The stored model's {name} is not an array of real numbers.")
    return array.astype(np.float64)


def _typed(kind: Any, value: Any, place: str) -> Any:
    """Convert a JSON value to the type of an annotation: a mapping to a dataclass, a list to a tuple."""
    origin, arguments = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        hints = _hints(kind)
        _check_keys(place, value, tuple(hints))
        return kind(**{name: _typed(hint, value[name], f"{place}.{name}") for name, hint in hints.items()})
    if origin in (Union, UnionType):
        return _typed(next((choice for choice in arguments if _fits(choice, value)), arguments[0]), value, place)
    if not _fits(kind, value):
        raise ModelFormatError(f"The stored {place} is of the wrong kind, {type(value).__name__}.")
    if origin is tuple:
        kinds = arguments[:1] * len(value) if arguments[-1] is ... else arguments
        if len(kinds) != len(value):
            raise ModelFormatError(f"The stored {place} has {len(value)} values, not {len(kinds)}.")
        return tuple(_typed(item, part, place) for item, part in zip(kinds, value, strict=True))
    if origin is dict:
        return {name: _typed(arguments[1], part, f"{place}.{name}") for name, part in value.items()}
    return value


def _fits(kind: Any, value: Any) -> bool:
    """Return whether a JSON value can be converted to a type; the elements of a list or mapping are not checked."""
    origin = get_origin(kind)
    if is_dataclass(kind) and isinstance(kind, type):
        return isinstance(value, Mapping) and set(value) == set(_hints(kind))
    if origin is Literal:
        return value in get_args(kind)
    if origin is tuple:
        return isinstance(value, list)
    if origin is dict:
        return isinstance(value, dict)
    if kind is float:  # JSON may write 1 for 1.0, and a number with too large an exponent is read as infinity.
        return type(value) in (int, float) and abs(value) <= sys.float_info.max
    return type(value) is kind


@cache
def _hints(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {declared.name: hints[declared.name] for declared in fields(kind)}


def _check_keys(what: str, content: Any, wanted: tuple[str, ...]) -> None:
    """Raise ModelFormatError unless a JSON value is a mapping with exactly the wanted keys."""
    if not isinstance(content, Mapping):
        raise ModelFormatError(f"The stored {what} must be a mapping of names to values.")
    missing = [key for key in wanted if key not in content]
    if missing:
        raise ModelFormatError(f"The stored {what} lacks the key {missing[0]!r}.")
    unknown = [key for key in content if key not in wanted]
    if unknown:
        raise ModelFormatError(f"The stored {what} has the unknown key {unknown[0]!r}.")
