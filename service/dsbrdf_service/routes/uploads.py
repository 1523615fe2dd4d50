"""Uploads of measurements: MERL files, RGL ``.bsdf`` files, and tables of samples.

They are hashed and checked while they are written; a body is never held whole, and nothing of it stays if anything is
wrong with it.
"""

import asyncio
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from typing import Any

from fastapi import Request

from dsbrdf.data.merl_validation import FILE_SIZE, HEADER_SIZE, MerlChecker, check_header, check_length
from dsbrdf.data.sample_tables import TABLE_SUFFIXES
from dsbrdf.data.table_options import TableOptions
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError

from ..errors import ProblemError
from ..http import openapi
from ..http.openapi import BINARY
from ..http.request_body import Sink, decoder, encoding_of, most_encoded
from ..jobs.steps import Kind, conversion_step
from ..storage.blobs import Incoming
from ..storage.schema import Caller, MeasurementRow
from ..storage.uploads import in_thread, threads_are_busy
from ..wire.fit_options import OF_TABLES
from ..wire.inputs import OPTIONS_SCHEMA
from ..wire.names import MAX_LENGTH
from .dependencies import Context, name_of

TABLES = (
    *("text/csv", "text/tab-separated-values", "text/plain"),
    "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
)
UPLOADED = (BINARY, *TABLES)
"""Media types of uploads."""
_SUFFIXES: dict[str, Kind] = {".bsdf": "rgl", **dict.fromkeys(TABLE_SUFFIXES, "samples")}
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
OPTION_PARAMETERS = [openapi.option_parameter(name, schema) for name, schema in OPTIONS_SCHEMA["properties"].items()]
TABLE_PARAMETERS = [parameter for parameter in OPTION_PARAMETERS if parameter["name"] in OF_TABLES]
"""Options of a fit, or of a table alone, in a query."""
CONTENT: dict[str, Any] = {media_type: openapi.file(media_type, maxLength=FILE_SIZE) for media_type in UPLOADED}

_PIECE = 1 << 19  # bytes that are worth a switch to another thread
_SMALL_PIECE = 1 << 16  # of many uploads at once
_BLOCK = 1 << 18  # bytes that are read back from the file at a time
_MAX_ENCODED = most_encoded(FILE_SIZE)
MOST_CONVERTED = 1 << 23
"""Bytes of an RGL file or a table: to read one takes up to 70 times as much memory."""


async def receive_upload(
    request: Request, context: Context, caller: Caller, media_type: str, options: TableOptions
) -> tuple[MeasurementRow, bool]:
    """Store the measurement that is the body; the flag says whether it is new to the caller.

    A table is read with the options, which are not stored. Raises InvalidArgumentError if it is none and they are used.
    Raises MeasurementFormatError if it is not an acceptable measurement of its kind. Raises ProblemError if it is too
    long, it does not decode, or the caller may not store it.
    """
    name = name_of(request)
    kind = _SUFFIXES.get(Path(name or "").suffix.lower())
    if name is not None and kind is not None:
        name = Path(name).stem
    kind = "samples" if media_type in TABLES else kind
    if kind is None:
        options.refuse_on_grid()
    declared = request.headers.get("content-length", "")
    length = int(declared) if declared.isdecimal() and not encoding_of(request) else None
    with context.metrics.timing("upload"):
        if kind is not None:
            _check_convertible(length or 0)
        async with context.store.uploads.incoming(caller) as incoming:
            at_once = context.store.uploads.few
            if kind is None:
                incoming.valid_nodes = await _write_merl(request, incoming, length, at_once=at_once)
                await in_thread(incoming.close)
            else:
                await _write(request, partial(_write_convertible, incoming), at_once=at_once)
                await in_thread(incoming.close)
                try:
                    incoming.sha256, incoming.size, incoming.valid_nodes = await context.computations.run_in_process(
                        request,
                        ("upload", incoming.path),
                        conversion_step,
                        incoming.path,
                        kind,
                        options.of_table(),
                        place="long",
                    )
                except InvalidArgumentError as error:  # as every fault of a step's arguments
                    raise MeasurementFormatError(str(error)) from None
            return await in_thread(context.store.add_measurement, caller, incoming, name)


async def _write_merl(request: Request, incoming: Incoming, length: int | None, *, at_once: bool) -> int:
    """Write the MERL file that the body decodes to; return the number of valid nodes.

    A wrong `length` that is declared is refused by the first bytes, with the sentence that the whole would get.
    Its values are checked `at_once` or at the end: a check takes memory that many uploads should not have together.
    """
    header = b""
    checker = MerlChecker() if at_once else None

    def write(data: bytes) -> None:
        nonlocal header
        if len(header) < HEADER_SIZE:
            header += data[: HEADER_SIZE - len(header)]
            if len(header) == HEADER_SIZE:
                check_header(header)
                if length is not None:
                    _check_not_longer(length)
                    check_length(length)
        _check_not_longer(incoming.size + len(data))
        incoming.write(data)
        if checker is not None:
            checker.update(data)

    def finish() -> int:
        """Check the whole, read back unless it has been checked already; return the number of valid nodes."""
        complete = checker or MerlChecker()
        while block := incoming.read(complete.n_bytes, _BLOCK):
            complete.update(block)
        return int(complete.finish().sum())

    await _write(request, write, at_once=at_once)
    return await in_thread(finish)


def _write_convertible(incoming: Incoming, data: bytes) -> None:
    """Write a part of a file of which nothing is known but its largest length."""
    _check_convertible(incoming.size + len(data))
    incoming.write(data)


async def _write(request: Request, write: Sink, *, at_once: bool) -> None:
    """Write what the body decodes to, each piece while the next one arrives."""
    n_received = 0
    feed, finish = decoder(encoding_of(request), write)
    writing: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    writing.set_result(None)
    try:
        async for piece in _pieces(request.stream(), _PIECE if at_once else _SMALL_PIECE):
            await writing
            n_received += len(piece)
            if n_received > _MAX_ENCODED:
                most = f"The body is longer than {_MAX_ENCODED} bytes, more than an encoded measurement takes."
                raise ProblemError("too-large", most)
            writing = asyncio.ensure_future(in_thread(feed, piece))
            # What is wrong with the header is told at once; with busy threads, reading ahead would only take memory.
            if n_received == len(piece) or threads_are_busy():
                await writing
        await writing
        await in_thread(finish)
    finally:
        await asyncio.gather(writing, return_exceptions=True)


async def _pieces(parts: AsyncIterator[bytes], least: int) -> AsyncIterator[bytes]:
    """Yield the header at once, as it may be wrong; the rest in pieces that are worth a switch to another thread."""
    waiting: list[bytes] = []
    size, enough = 0, HEADER_SIZE
    async for part in parts:
        waiting.append(part)
        size += len(part)
        if size >= enough:
            piece = part if size == len(part) else b"".join(waiting)
            waiting.clear()
            size, enough = 0, least
            yield piece
    if size:
        yield b"".join(waiting)


def _check_not_longer(n_bytes: int) -> None:
    if n_bytes > FILE_SIZE:
        try:
            check_length(n_bytes)
        except MeasurementFormatError as error:  # the library's sentence, with a kind of its own
            raise ProblemError("measurement-too-large", str(error)) from None


def _check_convertible(n_bytes: int) -> None:
    if n_bytes > MOST_CONVERTED:
        most = f"A .bsdf file or a table has at most {MOST_CONVERTED} bytes here, and this one is longer."
        raise ProblemError("measurement-too-large", most)
