"""Fits for other programs."""

from collections.abc import Callable
from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from dsbrdf import DSBRDF, FitReport
from dsbrdf.data.merl import encode_merl
from dsbrdf.output.serialize import to_json, to_npz
from service.access.authentication import fit_of
from service.context import context_of
from service.http import openapi
from service.routes.fits import FitId
from service.wire.schemas import Export

router = APIRouter(prefix="/v1/fits/{fit_id}/export", tags=["export"])

# format -> (media type, suffix, writer)
_FORMATS: dict[str, tuple[str, str, Callable[[DSBRDF, FitReport | None], bytes]]] = {
    "json": ("application/json", "json", lambda model, report: to_json(model, report).encode()),
    "npz": ("application/octet-stream", "npz", to_npz),
    "merl": ("application/octet-stream", "binary", lambda model, _: encode_merl(model.tabulate())),
}


@router.get(
    "",
    response_class=Response,
    summary="A fit for another program",
    responses=openapi.export() | openapi.problems("not-found", "fit-not-finished", "invalid-argument"),
)
async def export_fit(request: Request, fit_id: FitId, export: Annotated[Export, Query()]) -> Response:
    """Return the model, or one component, as `json` or `npz` (lossless) or as a MERL table.

    The report of the fit goes with the whole model in the lossless formats.
    """
    models = context_of(request).models
    fit = fit_of(request, fit_id)
    model = await models.part(fit, export.component)
    report = (await models.get(fit)).report if export.component is None else None
    media_type, suffix, write = _FORMATS[export.format]
    content = await run_in_threadpool(write, model, report)
    name = "-".join(part for part in (fit_id, export.component) if part)
    headers = {"Content-Disposition": f'attachment; filename="{name}.{suffix}"'}
    return Response(content, 200, headers, media_type)
