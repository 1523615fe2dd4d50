"""Upload, list, download and delete measurements."""

import os
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Query, Request
from pydantic import Field
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.responses import FileResponse, Response

from ..errors import MeasurementNotFoundError
from ..http import openapi
from ..http.names import content_disposition, given_name
from ..http.request_body import media_type_of
from ..http.request_log import IS_HEAD
from ..http.responses import BINARY, JSON, OpenFileResponse, not_modified, prefers, prefix_of, tagged_reply
from ..storage.blobs import OpenFile
from ..storage.database import in_write_thread
from ..storage.writing import in_thread
from .context import CHECKED_QUERY, Sha256, TheCaller, TheContext, TheTableOptions
from .fields import SHA256, Document, Name, Page, members, next_page
from .uploads import CONTENT, PARAMETERS, TABLE_PARAMETERS, UPLOADED, receive_upload


class MeasurementDocument(Document):
    """A stored measurement."""

    sha256: Annotated[str, Field(pattern=SHA256, description="Its identity: the sha256 of the file's bytes.")]
    name: Name
    size: Annotated[int, Field(description="Length of the file [bytes].")]
    valid_nodes: int
    """Grid nodes with a value in all channels, above the horizon; 0 for samples."""
    created: datetime


class MeasurementDetails(MeasurementDocument):
    """A stored measurement with its fits."""

    fits: Annotated[list[str], Field(description="Ids of its fits, newest first, at most 200 of them.")]


class MeasurementList(Document):
    """A page of measurements, newest first."""

    items: list[MeasurementDocument]


router = APIRouter(prefix="/v1/measurements", tags=["measurements"], dependencies=CHECKED_QUERY)

_VARY = {"Vary": "Accept"}
_MAX_LISTED_FITS = 200
_ACCEPT = openapi.header_parameter("Accept", f"`{BINARY}` asks for the file instead of the document.")
_FILE: openapi.Responses = {
    200: {"content": {BINARY: openapi.file(BINARY)}, **openapi.headers("ETag")},
    304: openapi.TAGGED[304],
    **openapi.problems("not-found", "measurement-damaged"),
}


@router.post(
    "",
    status_code=201,
    response_model=MeasurementDocument,
    responses={
        200: openapi.answer("The measurement was stored before.", MeasurementDocument, "Location"),
        201: openapi.answer("The measurement is stored; `Location` is its address.", MeasurementDocument, "Location"),
        **openapi.problems(*openapi.UPLOAD_PROBLEMS),
    },
    openapi_extra={
        "parameters": [*PARAMETERS, *TABLE_PARAMETERS],
        **openapi.body("A MERL file, an RGL .bsdf file, or a table of scattered samples.", CONTENT),
    },
)
async def upload_measurement(
    request: Request, context: TheContext, caller: TheCaller, options: TheTableOptions
) -> Response:
    """Store the measurement in the body; the answer is 201, or 200 if the measurement is stored already.

    A MERL file is stored byte for byte. An RGL `.bsdf` file is converted to a MERL table, and a table of samples is
    read with its options and converted to a file of samples. `sha256` and `size` describe the stored file.
    """
    media_type_of(request, *UPLOADED)
    row, new = await receive_upload(request, context, caller, given_name(request), options)
    headers = {"Location": f"{prefix_of(request)}/v1/measurements/{row.sha256}"}
    return Response(to_json(members(MeasurementDocument, row)), 201 if new else 200, headers, JSON)


@router.get("", response_model=MeasurementList, responses={200: openapi.headers("Link"), **openapi.problems()})
async def list_measurements(
    request: Request, context: TheContext, caller: TheCaller, page: Annotated[Page, Query()]
) -> Response:
    """Return a page of measurements, newest first; `Link` with `rel="next"` leads to the next page."""
    rows = await run_in_threadpool(context.store.measurements, caller.owner, page.limit + 1, page.cursor, page.name)
    items = [members(MeasurementDocument, row) for row in rows[: page.limit]]
    return Response(to_json({"items": items}), 200, next_page(request, page, rows), JSON)


@router.get("/{sha256}", response_model=MeasurementDetails, responses=_FILE, openapi_extra={"parameters": [_ACCEPT]})
async def get_measurement(request: Request, context: TheContext, caller: TheCaller, sha256: Sha256) -> Response:
    """Return the document of a measurement: name, size, time of the upload and fits.

    `HEAD` tells whether the measurement is stored. With `Accept: application/octet-stream` the answer is the file, as
    at the address `/content`.
    """
    if prefers(request, BINARY, JSON):
        return await download_measurement(request, context, caller, sha256)
    row = await run_in_threadpool(context.store.measurement, caller.owner, sha256)
    fits = await run_in_threadpool(context.store.fits_of, row.owner, row.sha256, _MAX_LISTED_FITS)
    return tagged_reply(request, to_json(members(MeasurementDocument, row) | {"fits": fits}), headers=_VARY)


@router.get(
    "/{sha256}/content",
    response_class=FileResponse,
    response_description="The file, byte for byte as it is stored.",
    responses=_FILE,
)
async def download_measurement(request: Request, context: TheContext, caller: TheCaller, sha256: Sha256) -> Response:
    """Return the stored file; its ETag is its sha256. `HEAD` tells whether the file is stored, without sending it."""
    row = await run_in_threadpool(context.store.measurement, caller.owner, sha256)
    headers = {"ETag": f'"{sha256}"', **_VARY}
    path = await in_thread(context.store.measurement_file, caller.owner, sha256)
    if known := not_modified(request, headers):
        return known
    if IS_HEAD in request.scope:
        return Response(None, 200, {**headers, "Content-Length": str(row.size)}, BINARY)
    try:
        suffix = ".binary" if row.on_grid else ".csv"
        headers["Content-Disposition"] = content_disposition(f"{row.name or sha256}{suffix}")
        file = OpenFile(os.open(path, os.O_RDONLY))
        return OpenFileResponse(file, headers | {"Content-Type": BINARY})
    except FileNotFoundError:  # The file was deleted after its row was read.
        raise MeasurementNotFoundError(sha256) from None


@router.delete(
    "/{sha256}",
    status_code=204,
    response_class=Response,
    responses=openapi.problems("not-found", "measurement-in-use", "disk-full"),
)
async def delete_measurement(context: TheContext, caller: TheCaller, sha256: Sha256) -> Response:
    """Delete a measurement; its finished fits stay. A measurement with unfinished fits stays, and the answer is 409."""
    if not await in_write_thread(context.store.remove_measurement, caller.owner, sha256):
        raise MeasurementNotFoundError(sha256)
    return Response(status_code=204)
