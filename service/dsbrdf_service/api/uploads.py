"""Receive uploads of measurements: MERL files, RGL ``.bsdf`` files, and tables of samples.

A file is hashed and checked while it is written, and is never held whole in memory. Nothing of a wrong file is stored.
"""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
from fastapi import Request

from dsbrdf.data.merl_validation import (
    FILE_SIZE,
    HEADER,
    HEADER_SIZE,
    ROW_NODES,
    check_header,
    check_length,
    check_values,
)
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError
from dsbrdf.samples.reading import START_BYTES, measurement_kind
from dsbrdf.samples.table_options import TableOptions

from ..compute.computations import Place
from ..compute.steps import conversion_step
from ..errors import ProblemError
from ..http import openapi
from ..http.names import MAX_LENGTH
from ..http.request_body import decoded
from ..http.responses import BINARY, JSON
from ..storage.blobs import Incoming
from ..storage.schema import Caller, MeasurementRow
from ..storage.writing import in_thread
from .context import Context
from .fields import OPTIONS_SCHEMA, TABLE_SCHEMA

TABLES = (
    *("text/csv", "text/tab-separated-values", "text/plain"),
    "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
)
UPLOADED = (BINARY, *TABLES, JSON)
"""Media types of uploads."""
_SUFFIXES = (".binary", ".bsdf", ".csv", ".tsv", ".txt", ".astm", ".xlsx")
PARAMETERS = [
    {
        "name": "name",
        "in": "query",
        "description": "Name of the measurement and of the fit; exports are called after it; "
        f"{', '.join(_SUFFIXES)} at its end is no part of the name.",
        "schema": {"type": "string", "minLength": 1, "maxLength": MAX_LENGTH},
    },
    openapi.header_parameter("Content-Disposition", "The file's name, where no `name` is given."),
    openapi.ENCODING,
]
OPTION_PARAMETERS, TABLE_PARAMETERS = (
    [openapi.option_parameter(name, declared) for name, declared in schema["properties"].items()]
    for schema in (OPTIONS_SCHEMA, TABLE_SCHEMA)
)
"""Query parameters for the options of a fit, and of a table."""
CONTENT: dict[str, Any] = {media_type: openapi.file(media_type, maxLength=FILE_SIZE) for media_type in UPLOADED}

_PIECE_BYTES = 1 << 15  # Every unfinished upload keeps one piece of this size in memory.
_MAX_SHORT_TEXT_BYTES = 1 << 16  # A longer text takes over a second to read, so its reading is a long computation.
_ZIP = b"PK"  # Every .xlsx file begins with these bytes.
MAX_CONVERTED_BYTES = 1 << 23
"""Limit of an RGL file or a table, because reading one takes up to 70 times as much memory."""


async def receive_upload(
    request: Request, context: Context, caller: Caller, name: str | None, options: TableOptions
) -> tuple[MeasurementRow, bool]:
    """Store the measurement in the body; return its row, and whether it is new to the caller.

    The kind of the file is determined from its content, not from its media type or name. A table is read with the
    options, and its samples are stored.

    Raises InvalidArgumentError if options are given for another file than a table, MeasurementFormatError if the file
    is not a measurement, and ProblemError if the body is too long, cannot be decoded, or exceeds the caller's quota.
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
                await _write(start, pieces, incoming, MAX_CONVERTED_BYTES, "A .bsdf file or a table")
                key, place = ("upload", incoming.path), place_of_table(start, incoming.size)
                found = await read_table(request, context, key, conversion_step, incoming.path, options, place=place)
                incoming.sha256, incoming.size, incoming.valid_nodes = found
            return await in_thread(context.store.add_measurement, caller, incoming, name)


async def _receive_merl(request: Request, start: bytes, pieces: AsyncIterator[bytes], incoming: Incoming) -> None:
    """Write and check a MERL file; a wrong header or a wrong declared length is refused after the first piece.

    Values are checked when all have arrived, so that an unfinished upload needs no memory for this check.
    """
    declared = request.headers.get("content-length", "")
    length = int(declared) if declared.isdecimal() and "content-encoding" not in request.headers else FILE_SIZE
    try:
        check_header(start)
        check_length(length)
    except MeasurementFormatError as error:
        if length > FILE_SIZE:
            raise ProblemError("measurement-too-large", str(error)) from None
        raise
    await _write(start, pieces, incoming, FILE_SIZE, "A MERL file")
    check_length(incoming.size)
    incoming.valid_nodes = await in_thread(_count_valid_nodes, incoming.path)


def _count_valid_nodes(path: Path) -> int:
    """Check the values of a MERL file; return the number of its nodes with a value."""
    with path.open("rb") as file:
        file.seek(HEADER_SIZE)
        rows = (np.fromfile(file, "<f8", ROW_NODES) for _ in range(HEADER_SIZE, FILE_SIZE, 8 * ROW_NODES))
        return int(check_values(rows).sum())


async def _write(start: bytes, pieces: AsyncIterator[bytes], incoming: Incoming, most: int, kind: str) -> None:
    """Write and close a file of a `kind`; raise ProblemError if the file is longer than `most` bytes."""
    piece = start
    while piece:
        if incoming.size + len(piece) > most:
            raise ProblemError(
                "measurement-too-large", f"{kind} has at most {most} bytes here, and this one is longer."
            )
        await in_thread(incoming.write, piece)
        del piece  # This piece is not kept in memory while the next one arrives.
        piece = await anext(pieces, b"")
    await in_thread(incoming.close)


def place_of_table(start: bytes, size: int) -> Place:
    """Return how long the reading of a table takes, as a `Place`: `medium` for a short text, otherwise `long`."""
    is_short_text = size <= _MAX_SHORT_TEXT_BYTES and measurement_kind(start) == "samples" and start[:2] != _ZIP
    return "medium" if is_short_text else "long"


async def read_table(request: Request, context: Context, *arguments: Any, **named: Any) -> Any:
    """Read a table in a separate process; raise MeasurementFormatError if the table is refused."""
    try:
        return await context.computations.run_in_process(request, *arguments, **named)
    except InvalidArgumentError as error:
        raise MeasurementFormatError(str(error)) from None


async def _pieces(request: Request) -> AsyncIterator[bytes]:
    """Yield the decoded body: first enough bytes to recognise the kind of the file, then further pieces."""
    piece, begun = b"", False
    async for part in decoded(request, FILE_SIZE):
        piece += part
        if not begun and (len(piece) >= START_BYTES or piece.startswith(HEADER)):
            yield piece[:START_BYTES]
            piece, begun = piece[START_BYTES:], True
        if begun and len(piece) >= _PIECE_BYTES:
            yield piece
            piece = b""
    yield piece
