"""From rows and models to JSON documents."""

from collections.abc import Iterable
from dataclasses import asdict

from dsbrdf.model.decomposition import Component
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.report_text import component_document, lobes_document
from service.storage.schema import FitRow, MeasurementRow
from service.wire.schemas import ComponentList, FitDocument, FitSummary, MeasurementDocument, Progress


def fit_summary(row: FitRow, progress: float) -> FitSummary:
    """Return a fit's document without lobes."""
    return FitSummary.model_validate({**asdict(row), "progress": progress})


def fit_document(row: FitRow, progress: float, model: DSBRDF | None) -> FitDocument:
    """Return a fit's document; `model` is that of a fit that succeeded."""
    lobes = None if model is None else lobes_document(model)
    return FitDocument.model_validate({**asdict(row), "progress": progress, "lobes": lobes})


def fit_progress(row: FitRow, progress: float) -> Progress:
    """Return the event that reports a fit's state."""
    return Progress.model_validate({**asdict(row), "progress": progress})


def measurement_document(row: MeasurementRow) -> MeasurementDocument:
    """Return a measurement's document."""
    return MeasurementDocument.model_validate(asdict(row))


def component_list(decomposition: Iterable[Component]) -> ComponentList:
    """Return the components' document."""
    return ComponentList.model_validate({"items": [component_document(component) for component in decomposition]})
