"""Measurements: upload once, fit often."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import FileResponse, Response

from service.access.authentication import owner_of
from service.context import context_of
from service.http import examples, openapi
from service.http.problems import ProblemError
from service.http.request_body import receive_measurement
from service.http.responses import OpenFileResponse, check_range, json_reply, next_page, not_modified
from service.jobs.model_cache import no_such_measurement
from service.storage.rows import MeasurementRow
from service.storage.store import MeasurementInUseError
from service.wire.conversions import measurement_document
from service.wire.schemas import SHA256, MeasurementDocument, MeasurementList, Page

router = APIRouter(prefix="/v1/measurements", tags=["measurements"])
Sha256 = Annotated[str, Path(pattern=SHA256, description="The sha256 of the file's bytes.", examples=[examples.SHA256])]

_RAW = "application/octet-stream"


@router.post(
    "",
    status_code=201,
    response_model=MeasurementDocument,
    summary="Upload a measurement",
    responses=openapi.example(examples.MEASUREMENT, "The measurement is stored.", 201)
    | openapi.example(examples.MEASUREMENT, "The measurement was stored before.", 200, "MeasurementDocument")
    | openapi.problems(
        "bad-encoding", "measurement-too-large", "unsupported-media-type", "measurement-format", "disk-full"
    ),
    openapi_extra=openapi.raw_upload(),
)
async def upload_measurement(request: Request) -> Response:
    """Store the MERL file that is the body: 201, or 200 if the same bytes are stored already."""
    media_type = request.headers.get("content-type", _RAW).partition(";")[0].strip().lower()
    if media_type != _RAW:
        detail = f"The content type {media_type[:60]!r} is not supported; send a MERL file as {_RAW}."
        raise ProblemError("unsupported-media-type", detail, {"Accept-Post": _RAW})
    context = context_of(request)
    with context.metrics.timing("upload"):
        row, new = await receive_measurement(request, context.store)
    headers = {"Location": f"/v1/measurements/{row.sha256}", "ETag": f'"{row.sha256}"'}
    return json_reply(measurement_document(row), 201 if new else 200, headers)


@router.get(
    "",
    response_model=MeasurementList,
    summary="List the measurements",
    responses=openapi.example(examples.MEASUREMENT_LIST, "Measurements, newest first.")
    | openapi.problems("invalid-argument"),
)
async def list_measurements(request: Request, page: Annotated[Page, Query()]) -> Response:
    """Return a page of measurements, newest first; `Link` with `rel="next"` leads to the next one."""
    before = None if page.cursor is None else int(page.cursor)
    store = context_of(request).store
    rows = await run_in_threadpool(store.measurements, owner_of(request), page.limit, before)
    headers = next_page(request, page.limit, len(rows), rows[-1].seq if rows else None)
    return json_reply(MeasurementList(items=[measurement_document(row) for row in rows]), headers=headers)


@router.get(
    "/{sha256}",
    response_class=FileResponse,
    summary="Download a measurement",
    responses=openapi.binary(_RAW, "The file, byte for byte as it was uploaded.") | openapi.problems("not-found"),
)
async def download_measurement(request: Request, sha256: Sha256) -> Response:
    """Return the file as it was uploaded; its ETag is its sha256, and a part of it can be had with `Range`."""
    row = await _row(request, sha256)
    headers = _headers(row)
    if not_modified(request, headers["ETag"]):
        return Response(None, 304, headers)
    check_range(request, row.size)
    path = context_of(request).store.blobs.path(sha256)
    try:
        return await run_in_threadpool(OpenFileResponse, path, headers, _RAW)
    except FileNotFoundError:  # deleted since its row was read
        raise no_such_measurement(sha256) from None


@router.head(
    "/{sha256}", response_class=Response, summary="Ask for a measurement", responses=openapi.problems("not-found")
)
async def probe_measurement(request: Request, sha256: Sha256) -> Response:
    """Tell whether the measurement is stored, so that an upload can be spared."""
    row = await _row(request, sha256)
    headers = _headers(row)
    if not_modified(request, headers["ETag"]):
        return Response(None, 304, headers)
    return Response(None, 200, {**headers, "Content-Length": str(row.size)}, _RAW)


@router.delete(
    "/{sha256}",
    status_code=204,
    response_class=Response,
    summary="Delete a measurement",
    responses=openapi.problems("not-found", "measurement-in-use"),
)
async def delete_measurement(request: Request, sha256: Sha256) -> Response:
    """Delete the file; finished fits of it stay, unfinished ones forbid it (409)."""
    try:
        store = context_of(request).store
        removed = await run_in_threadpool(store.remove_measurement, owner_of(request), sha256)
    except MeasurementInUseError as error:
        detail = f"{str(error).capitalize()}; cancel them or wait until they have ended."
        raise ProblemError("measurement-in-use", detail) from None
    if not removed:
        raise no_such_measurement(sha256)
    return Response(status_code=204)


async def _row(request: Request, sha256: str) -> MeasurementRow:
    row = await run_in_threadpool(context_of(request).store.measurement, owner_of(request), sha256)
    if row is None:
        raise no_such_measurement(sha256)
    return row


def _headers(row: MeasurementRow) -> dict[str, str]:
    return {"ETag": f'"{row.sha256}"', "Cache-Control": "private, max-age=31536000, immutable"}
