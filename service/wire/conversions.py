"""From rows and models to JSON documents."""

from collections.abc import Iterable
from datetime import UTC, datetime

from dsbrdf import DSBRDF, Component
from dsbrdf.output.report_text import component_document, lobes_document
from service.storage.schema import FitRow, MeasurementRow
from service.wire.schemas import (
    ComponentList,
    FitDocument,
    FitFault,
    FitSummary,
    Lobes,
    MeasurementDocument,
    Progress,
)


def fit_summary(row: FitRow, progress: float) -> FitSummary:
    """Return a fit's document without lobes."""
    return FitSummary(
        id=row.id,
        status=row.status,
        progress=progress,
        measurement=row.measurement,
        options=row.options,
        metrics=row.metrics,
        error=_fault(row),
        created=_time(row.created),
        started=None if row.started is None else _time(row.started),
        finished=None if row.finished is None else _time(row.finished),
        algorithm=row.algorithm,
        library=row.library,
    )


def fit_document(row: FitRow, progress: float, model: DSBRDF | None) -> FitDocument:
    """Return a fit's document; `model` is that of a fit that succeeded."""
    summary = fit_summary(row, progress)
    return FitDocument(**dict(summary), lobes=None if model is None else Lobes.model_validate(lobes_document(model)))


def fit_progress(row: FitRow, progress: float) -> Progress:
    """Return the event that tells of a fit's state."""
    return Progress(id=row.id, status=row.status, progress=progress, error=_fault(row))


def measurement_document(row: MeasurementRow) -> MeasurementDocument:
    """Return a measurement's document."""
    return MeasurementDocument(
        sha256=row.sha256, size=row.size, valid_nodes=row.valid_nodes, created=_time(row.created)
    )


def component_list(decomposition: Iterable[Component]) -> ComponentList:
    """Return the components' document."""
    return ComponentList.model_validate({"items": [component_document(component) for component in decomposition]})


def _fault(row: FitRow) -> FitFault | None:
    return None if row.error is None else FitFault.model_validate(row.error)


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
