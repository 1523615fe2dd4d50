"""Uploads of measurements: MERL files, RGL ``.bsdf`` files, and tables of samples.

They are hashed and checked while they are written; a body is never held whole, and nothing of it stays if anything is
wrong with it.
"""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from fastapi import Request

from dsbrdf.data.merl_validation import FILE_SIZE, HEADER_SIZE, MerlChecker, check_length
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError
from dsbrdf.samples.table_options import TableOptions

from ..compute.steps import Kind, conversion_step
from ..errors import ProblemError
from ..http import openapi
from ..http.names import MAX_LENGTH
from ..http.request_body import decoded
from ..http.responses import BINARY
from ..storage.blobs import Incoming
from ..storage.schema import Caller, MeasurementRow
from ..storage.uploads import in_thread
from .context import Context
from .fields import OPTIONS_SCHEMA, TABLE_SCHEMA

TABLES = (
    *("text/csv", "text/tab-separated-values", "text/plain"),
    "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
)
UPLOADED = (BINARY, *TABLES)
"""Media types of uploads."""
_SUFFIXES: dict[str, Kind] = {".bsdf": "rgl", **dict.fromkeys((".csv", ".tsv", ".txt", ".astm", ".xlsx"), "samples")}
PARAMETERS = [
    {
        "name": "name",
        "in": "query",
        "description": "Name of the measurement and of the fit; exports are called after it. Of an upload, "
        f"{', '.join(_SUFFIXES)} at its end tells the kind of file, and is no part of the name.",
        "schema": {"type": "string", "minLength": 1, "maxLength": MAX_LENGTH},
    },
    openapi.header_parameter("Content-Disposition", "The file's name, where no `name` is given."),
    openapi.ENCODING,
]
OPTION_PARAMETERS, TABLE_PARAMETERS = (
    [openapi.option_parameter(name, declared) for name, declared in schema["properties"].items()]
    for schema in (OPTIONS_SCHEMA, TABLE_SCHEMA)
)
"""Options of a fit, and of a table, in a query."""
CONTENT: dict[str, Any] = {media_type: openapi.file(media_type, maxLength=FILE_SIZE) for media_type in UPLOADED}

_PIECE = 1 << 18  # bytes that are worth a switch to another thread
MOST_CONVERTED = 1 << 23
"""Bytes of an RGL file or a table: to read one takes up to 70 times as much memory."""


async def receive_upload(
    request: Request, context: Context, caller: Caller, name: str | None, media_type: str, options: TableOptions
) -> tuple[MeasurementRow, bool]:
    """Store the measurement that is the body; the flag says whether it is new to the caller.

    The end of its `name` can tell the kind of file. A table is read with the options, and its samples are stored.
    Raises InvalidArgumentError if it is none and they are used. Raises MeasurementFormatError if it is no measurement
    of its kind. Raises ProblemError if it is too long, it does not decode, or the caller may not store it.
    """
    kind = _SUFFIXES.get(Path(name or "").suffix.lower())
    if name is not None and kind is not None:
        name = Path(name).stem
    kind = "samples" if media_type in TABLES else kind
    if kind is None:
        options.refuse("a MERL file")
    with context.metrics.upload_seconds.time():
        async with context.store.uploads.incoming(caller) as incoming:
            if kind is None:
                await _receive_merl(request, incoming)
            else:
                await _receive_other(request, context, incoming, kind, options)
            return await in_thread(context.store.add_measurement, caller, incoming, name)


async def _receive_merl(request: Request, incoming: Incoming) -> None:
    """Write and check the MERL file that is the body; a wrong length that is declared is refused by the first bytes."""
    checker, declared = MerlChecker(), request.headers.get("content-length", "")
    length = int(declared) if declared.isdecimal() and "content-encoding" not in request.headers else FILE_SIZE

    def write(piece: bytes) -> None:
        try:
            checker.update(piece)
            check_length(length)
        except MeasurementFormatError as error:
            if max(checker.n_bytes, length) > FILE_SIZE:
                raise ProblemError("measurement-too-large", str(error)) from None
            raise
        incoming.write(piece)

    async for piece in _pieces(request):
        await in_thread(write, piece)
    incoming.valid_nodes = int((await in_thread(checker.finish)).sum())
    await in_thread(incoming.close)


async def _receive_other(
    request: Request, context: Context, incoming: Incoming, kind: Kind, options: TableOptions
) -> None:
    """Write a file that is no MERL file; replace it when it is complete by a MERL table, or by a file of samples."""
    async for piece in _pieces(request):
        if incoming.size + len(piece) > MOST_CONVERTED:
            most = f"A .bsdf file or a table has at most {MOST_CONVERTED} bytes here, and this one is longer."
            raise ProblemError("measurement-too-large", most)
        await in_thread(incoming.write, piece)
    await in_thread(incoming.close)
    key, arguments = ("upload", incoming.path), (incoming.path, kind, options)
    incoming.sha256, incoming.size, incoming.valid_nodes = await read_table(
        request, context, key, conversion_step, *arguments, place="long"
    )


async def read_table(request: Request, context: Context, *arguments: Any, **named: Any) -> Any:
    """Return as `Computations.run_in_process`; what is wrong with a file is no argument's fault."""
    try:
        return await context.computations.run_in_process(request, *arguments, **named)
    except InvalidArgumentError as error:
        raise MeasurementFormatError(str(error)) from None


async def _pieces(request: Request) -> AsyncIterator[bytes]:
    """Yield what the body decodes to: a MERL header at once, as it may be wrong, and then larger pieces."""
    piece, enough = bytearray(), HEADER_SIZE
    async for part in decoded(request, FILE_SIZE):
        piece += part
        if len(piece) >= enough:
            yield bytes(piece)
            piece, enough = bytearray(), _PIECE
    yield bytes(piece)
