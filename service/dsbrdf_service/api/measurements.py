"""Upload, list, download and delete measurements, and describe tables of samples before their upload.

An upload is a MERL file, an RGL ``.bsdf`` file or a table. It is hashed and checked while it is written, and is never
held whole in memory; nothing of a wrong file is stored.
"""

import os
from collections.abc import AsyncIterator
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, Field
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.responses import FileResponse, Response

from dsbrdf.data import merl_validation as merl
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError
from dsbrdf.output.documents import ANGLE_NAMES
from dsbrdf.samples.reading import START_BYTES, measurement_kind
from dsbrdf.samples.table_options import TableOptions

from ..compute.computations import Duration
from ..compute.steps import conversion_step, understood_step
from ..errors import MeasurementNotFoundError, ProblemError
from ..http import openapi
from ..http.messages import (
    BINARY,
    JSON,
    OpenFileResponse,
    content_disposition,
    given_name,
    media_type_of,
    not_modified,
    pieces_of,
    prefers,
    prefix_of,
    tagged_reply,
)
from ..http.middleware import IS_HEAD
from ..storage.database import in_write_thread
from ..storage.files import Incoming, OpenFile, in_thread
from ..storage.schema import Caller, MeasurementRow
from ..wire import MAX_NAME_LENGTH
from .context import CHECKED_QUERY, Context, Sha256, TheCaller, TheContext, TheTableOptions
from .fields import OPTIONS_SCHEMA, SHA256, TABLE_SCHEMA, Document, Name, Page, Range, Share, members, next_page

router = APIRouter(prefix="/v1", tags=["measurements"], dependencies=CHECKED_QUERY)

TABLES = (
    *("text/csv", "text/tab-separated-values", "text/plain"),
    "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
)
UPLOADED = (BINARY, *TABLES, JSON)
"""Media types of uploads."""
_SUFFIXES = (".binary", ".bsdf", ".csv", ".tsv", ".txt", ".astm", ".xlsx", ".ods", ".xls")
PARAMETERS = [
    {
        "name": "name",
        "in": "query",
        "description": "Name of the measurement and of the fit; exports have it too; "
        f"the suffix {', '.join(_SUFFIXES[:-1])} or {_SUFFIXES[-1]} at its end is removed.",
        "schema": {"type": "string", "minLength": 1, "maxLength": MAX_NAME_LENGTH},
    },
    openapi.header_parameter("Content-Disposition", "The file's name, where no `name` is given."),
]
OPTION_PARAMETERS, TABLE_PARAMETERS = (
    [openapi.option_parameter(name, declared) for name, declared in schema["properties"].items()]
    for schema in (OPTIONS_SCHEMA, TABLE_SCHEMA)
)
"""Query parameters for the options of a fit, and of a table."""
CONTENT: dict[str, Any] = {media_type: openapi.file(media_type, maxLength=merl.FILE_SIZE) for media_type in UPLOADED}

_PIECE_BYTES = 1 << 17  # Every unfinished upload keeps one piece of this size in memory.
_MAX_SHORT_TEXT_BYTES = 1 << 16  # A longer text takes over a second to read, so its reading is a long computation.
_ZIP = b"PK"  # Every .xlsx or .ods file begins with these bytes.
_MAX_CONVERTED_BYTES = 1 << 23  # Reading an RGL file or a table takes up to 70 times as much memory.


async def receive_upload(
    request: Request, context: Context, caller: Caller, name: str | None, options: TableOptions
) -> tuple[MeasurementRow, bool]:
    """Store the measurement in the body; return its row, and whether it is new to the caller.

    The kind of the file is determined from its content, not from its media type or name. A table is read with the
    options, and its samples are stored.

    Raises InvalidArgumentError if options are given for another file than a table, MeasurementFormatError if the file
    is not a measurement, and ProblemError if the body is too long or encoded, or exceeds the caller's quota.
    """
    if name is not None and Path(name).suffix.lower() in _SUFFIXES:
        name = Path(name).stem
    with context.metrics.upload_seconds.time():
        async with context.store.writing.incoming(caller) as incoming:
            pieces = _pieces(request)
            start = await anext(pieces)
            if measurement_kind(start) == "merl":
                options.refuse("a MERL file")
                await _receive_merl(request, start, pieces, incoming)
            else:
                await _write(start, pieces, incoming, _MAX_CONVERTED_BYTES, "A .bsdf file or a table")
                size, path = incoming.size, incoming.path
                found = await _read_table(request, context, start, size, conversion_step, path, options)
                incoming.sha256, incoming.size, incoming.valid_nodes = found
            return await in_thread(context.store.add_measurement, caller, incoming, name)


async def _receive_merl(request: Request, start: bytes, pieces: AsyncIterator[bytes], incoming: Incoming) -> None:
    """Write and check a MERL file; a wrong header or a wrong declared length is refused after the first piece.

    Values are checked when all have arrived, so that an unfinished upload needs no memory for this check.
    """
    declared = request.headers.get("content-length", "")
    length = int(declared) if declared.isdecimal() else merl.FILE_SIZE
    try:
        merl.check_header(start)
        merl.check_length(length)
    except MeasurementFormatError as error:
        if length > merl.FILE_SIZE:
            raise ProblemError("measurement-too-large", str(error)) from None
        raise
    await _write(start, pieces, incoming, merl.FILE_SIZE, "A MERL file")
    merl.check_length(incoming.size)
    incoming.valid_nodes = await in_thread(_count_valid_nodes, incoming.path)


def _count_valid_nodes(path: Path) -> int:
    """Check the values of a MERL file; return the number of its nodes with a value."""
    with path.open("rb") as file:
        file.seek(merl.HEADER_SIZE)
        rows = (np.fromfile(file, "<f8", merl.ROW_NODES) for _ in range(3 * merl.N_ROWS))
        return int(merl.check_values(rows).sum())


async def _write(start: bytes, pieces: AsyncIterator[bytes], incoming: Incoming, max_bytes: int, kind: str) -> None:
    """Write and close a file of a `kind`; raise ProblemError if the file is longer than `max_bytes` bytes."""
    piece = start
    while piece:
        if incoming.size + len(piece) > max_bytes:
            detail = f"{kind} has at most {max_bytes} bytes here, and this one is longer."
            raise ProblemError("measurement-too-large", detail)
        await in_thread(incoming.write, piece)
        del piece  # This piece is not kept in memory while the next one arrives.
        piece = await anext(pieces, b"")
    await in_thread(incoming.close)


async def _read_table(request: Request, context: Context, start: bytes, size: int, *step: Any) -> Any:
    """Read a table of `size` bytes in a separate process; raise MeasurementFormatError if the table is refused."""
    is_short_text = size <= _MAX_SHORT_TEXT_BYTES and measurement_kind(start) == "samples" and start[:2] != _ZIP
    duration: Duration = "medium" if is_short_text else "long"
    try:
        return await context.computations.run_in_process(request, *step, duration=duration)
    except InvalidArgumentError as error:
        raise MeasurementFormatError(str(error)) from None


async def _pieces(request: Request) -> AsyncIterator[bytes]:
    """Yield the body: first enough bytes to recognise the kind of the file, then further pieces."""
    piece, begun = b"", False
    async for part in pieces_of(request):
        piece += part
        if not begun and (len(piece) >= START_BYTES or piece.startswith(merl.HEADER)):
            yield piece[:START_BYTES]
            piece, begun = piece[START_BYTES:], True
        if begun and len(piece) >= _PIECE_BYTES:
            yield piece
            piece = b""
    yield piece


class ColumnDocument(BaseModel):
    """A column of a table."""

    name: str
    read_as: Annotated[str | None, Field(description="What it means; null if it is not read.")]
    unit: Annotated[str, Field(description="The unit that the table states; empty if it states none.")]


class TableDocument(BaseModel):
    """Columns, ranges and samples of a table, as the library reads it."""

    n_rows: int
    n_samples: Annotated[int, Field(description="Rows that can be fitted.")]
    columns: list[ColumnDocument]
    ranges: Annotated[
        dict[str, Range],
        Field(description=f"Smallest and largest of {', '.join(ANGLE_NAMES)}, red, green and blue [1/sr]."),
    ]
    angles_of_incidence_deg: Annotated[list[float] | None, Field(description="Angles theta_in, if they are few.")]
    in_plane_of_incidence: Annotated[Share, Field(description="Fraction of the samples in the plane of incidence.")]
    warnings: list[str]
    first: Annotated[list[list[float]], Field(description="The first samples, with numbers in the order of `ranges`.")]


@router.post(
    "/tables",
    responses=openapi.problems("too-large", "measurement-format", *openapi.BODY_PROBLEMS),
    openapi_extra={"parameters": TABLE_PARAMETERS, **openapi.body("A table of scattered samples.", CONTENT)},
)
async def describe_table(request: Request, context: TheContext, options: TheTableOptions) -> TableDocument:
    """Return columns, units, ranges, warnings and the first samples of the table in the body.

    Nothing is stored, so the right options can be found before the upload.
    """
    media_type_of(request, *UPLOADED)
    async with context.bodies.received(request, _MAX_CONVERTED_BYTES) as content:
        start, size = content[:START_BYTES], len(content)
        return TableDocument(**await _read_table(request, context, start, size, understood_step, content, options))


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


_UPLOADS = "A MERL file, an RGL .bsdf file, or a table of scattered samples."
_VARY = {"Vary": "Accept"}
_MAX_LISTED_FITS = 200
_ACCEPT = openapi.header_parameter("Accept", f"`{BINARY}` asks for the file instead of the document.")
_FILE: openapi.Responses = {
    200: {"content": {BINARY: openapi.file(BINARY)}, **openapi.headers("ETag")},
    304: openapi.TAGGED[304],
    **openapi.problems("not-found", "measurement-damaged"),
}


@router.post(
    "/measurements",
    status_code=201,
    response_model=MeasurementDocument,
    responses={
        200: openapi.answer("The measurement was stored before.", MeasurementDocument, "Location"),
        201: openapi.answer("The measurement is stored; `Location` is its address.", MeasurementDocument, "Location"),
        **openapi.problems(*openapi.UPLOAD_PROBLEMS),
    },
    openapi_extra={"parameters": [*PARAMETERS, *TABLE_PARAMETERS], **openapi.body(_UPLOADS, CONTENT)},
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


@router.get(
    "/measurements", response_model=MeasurementList, responses={200: openapi.headers("Link"), **openapi.problems()}
)
async def list_measurements(
    request: Request, context: TheContext, caller: TheCaller, page: Annotated[Page, Query()]
) -> Response:
    """Return a page of measurements, newest first; `Link` with `rel="next"` leads to the next page."""
    rows = await run_in_threadpool(context.store.measurements, caller.owner, page.limit + 1, page.cursor, page.name)
    items = [members(MeasurementDocument, row) for row in rows[: page.limit]]
    return Response(to_json({"items": items}), 200, next_page(request, page, rows), JSON)


@router.get(
    "/measurements/{sha256}",
    response_model=MeasurementDetails,
    responses=_FILE,
    openapi_extra={"parameters": [_ACCEPT]},
)
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
    "/measurements/{sha256}/content",
    response_class=FileResponse,
    response_description="The file, byte for byte as it is stored.",
    responses=_FILE,
)
async def download_measurement(request: Request, context: TheContext, caller: TheCaller, sha256: Sha256) -> Response:
    """Return the stored file; its ETag is its sha256. `HEAD` tells whether the file is stored, without sending it."""
    headers = {"ETag": f'"{sha256}"', **_VARY}
    row, path = await in_thread(context.store.measurement_file, caller.owner, sha256)
    if known := not_modified(request, headers):
        return known
    if IS_HEAD in request.scope:
        return Response(None, 200, {**headers, "Content-Length": str(row.size)}, BINARY)
    try:
        suffix = ".binary" if row.on_grid else ".csv"
        headers["Content-Disposition"] = content_disposition(f"{row.name or sha256}{suffix}")
        return OpenFileResponse(OpenFile(os.open(path, os.O_RDONLY)), headers | {"Content-Type": BINARY})
    except FileNotFoundError:  # The file was deleted after its row was read.
        raise MeasurementNotFoundError(sha256) from None


@router.delete(
    "/measurements/{sha256}",
    status_code=204,
    response_class=Response,
    responses=openapi.problems("not-found", "measurement-in-use", "disk-full"),
)
async def delete_measurement(context: TheContext, caller: TheCaller, sha256: Sha256) -> Response:
    """Delete a measurement; its finished fits stay. A measurement with unfinished fits stays, and the answer is 409."""
    if not await in_write_thread(context.store.remove_measurement, caller.owner, sha256):
        raise MeasurementNotFoundError(sha256)
    return Response(status_code=204)
