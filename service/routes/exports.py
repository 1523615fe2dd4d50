"""Fits for other programs."""

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from dsbrdf.output.export import FORMATS, export_model
from service.http import openapi
from service.http.openapi import BINARY, JSON
from service.routes.dependencies import TheContext, TheFit
from service.wire import examples
from service.wire.schemas import Export

router = APIRouter(prefix="/v1/fits/{fit_id}/export", tags=["export"])


@router.get(
    "",
    response_class=Response,
    summary="A fit for another program",
    responses=openapi.response(
        "The file: JSON for `json`, bytes for the other formats.",
        content={
            BINARY: openapi.file(BINARY),
            JSON: {"schema": {"type": "object"}, "example": openapi.kept(examples.STORED_MODEL)},
        },
        headers=["Content-Disposition"],
    )
    | openapi.problems("not-found", "fit-not-finished", "invalid-argument"),
)
async def export_fit(context: TheContext, fit: TheFit, export: Annotated[Export, Query()]) -> Response:
    """Return the model, or one component, as `json` or `npz` (lossless) or as a MERL table.

    The report of the fit goes with the whole model in the lossless formats.
    """
    model = await context.models.component(fit, export.component)
    report = (await context.models.get(fit)).report if export.component is None else None
    content = await run_in_threadpool(export_model, model, export.format, report)
    name = "-".join(part for part in (fit.id, export.component) if part)
    headers = {"Content-Disposition": f'attachment; filename="{name}.{FORMATS[export.format].suffix}"'}
    return Response(content, 200, headers, FORMATS[export.format].media_type)
