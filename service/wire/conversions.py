"""Rows and models as wire documents."""

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from dsbrdf import DSBRDF, Component
from service.storage.rows import FitRow, MeasurementRow
from service.wire.schemas import (
    ComponentDocument,
    FitDocument,
    FitFault,
    FitSummary,
    Lobes,
    MeasurementDocument,
    Progress,
)

_DECIMALS = 10  # of a degree


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
    return FitDocument(**dict(summary), lobes=None if model is None else lobes(model))


def fit_progress(row: FitRow, progress: float) -> Progress:
    """Return the event that tells of a fit's state."""
    return Progress(id=row.id, status=row.status, progress=progress, error=_fault(row))


def measurement_document(row: MeasurementRow) -> MeasurementDocument:
    """Return a measurement's document."""
    return MeasurementDocument(
        sha256=row.sha256, size=row.size, valid_nodes=row.valid_nodes, created=_time(row.created)
    )


def component_document(component: Component) -> ComponentDocument:
    """Return a component's document."""
    width = component.half_width
    return ComponentDocument(
        label=component.label,  # type: ignore[arg-type]  # one of LABELS, checked by the schema
        lobes=list(component.lobes),
        parameters=lobes(component),
        albedo=component.albedo.tolist(),
        half_width_deg=None if width is None else float(np.degrees(width)),
        margin=component.margin,
    )


def lobes(model: DSBRDF) -> Lobes:
    """Return a model's parameters with angles in degrees."""
    return Lobes(
        theta_diff_deg=_degrees(model.theta_diff).tolist(),
        kappa=model.kappa.tolist(),
        gamma=model.gamma.tolist(),
        center_deg=_degrees(model.center).tolist(),
        delta=model.delta.tolist(),
        interpolation=model.interpolation,
    )


def _fault(row: FitRow) -> FitFault | None:
    return None if row.error is None else FitFault.model_validate(row.error)


def _degrees(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.degrees(angle).round(_DECIMALS), dtype=np.float64)


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
