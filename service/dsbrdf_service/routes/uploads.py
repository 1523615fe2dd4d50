"""Uploads of measurements: MERL files, RGL ``.bsdf`` files, and tables of samples.

They are hashed and checked while they are written; a body is never held whole, and nothing of it stays if anything is
wrong with it.
"""

from functools import partial
from pathlib import Path
from typing import Any

from fastapi import Request

from dsbrdf.data.merl_validation import FILE_SIZE, HEADER_SIZE, MerlChecker, check_length
from dsbrdf.data.sample_tables import TABLE_SUFFIXES
from dsbrdf.data.table_options import TableOptions
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError

from ..errors import ProblemError
from ..http import openapi
from ..http.openapi import BINARY
from ..http.request_body import Sink, decoder, encoding_of
from ..jobs.steps import Kind, conversion_step
from ..storage.blobs import Incoming
from ..storage.schema import Caller, MeasurementRow
from ..storage.uploads import in_thread
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

_PIECE = 1 << 18  # bytes that are worth a switch to another thread
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
    if kind is not None:
        _check_longest(length or 0, kind)
    with context.metrics.stages["upload"].time():
        async with context.store.uploads.incoming(caller) as incoming:
            if kind is None:
                await _write_merl(request, incoming, length)
            else:
                await _write(request, partial(_write_convertible, incoming, kind))
            await in_thread(incoming.close)
            if kind is not None:
                await _convert(request, context, incoming, kind, options)
            return await in_thread(context.store.add_measurement, caller, incoming, name)


async def _write_merl(request: Request, incoming: Incoming, length: int | None) -> None:
    """Write and check the MERL file that the body decodes to.

    A wrong `length` that is declared is refused by the first bytes, with the sentence that the whole would get.
    """
    checker = MerlChecker()

    def write(data: bytes) -> None:
        _check_longest(incoming.size + len(data), None)
        checker.update(data)
        if length is not None and checker.n_bytes >= HEADER_SIZE:
            _check_longest(length, None)
            check_length(length)
        incoming.write(data)

    await _write(request, write)
    incoming.valid_nodes = int((await in_thread(checker.finish)).sum())


def _write_convertible(incoming: Incoming, kind: Kind, data: bytes) -> None:
    """Write a part of a file of which nothing is known but its largest length."""
    _check_longest(incoming.size + len(data), kind)
    incoming.write(data)


async def _convert(request: Request, context: Context, incoming: Incoming, kind: Kind, options: TableOptions) -> None:
    """Check a file that is no MERL file, and replace that of RGL by a MERL table."""
    key, arguments = ("upload", incoming.path), (incoming.path, kind, options.of_table())
    run = context.computations.run_in_process
    try:
        found = await run(request, key, conversion_step, *arguments, place="long")
    except InvalidArgumentError as error:  # as every fault of a step's arguments
        raise MeasurementFormatError(str(error)) from None
    incoming.sha256, incoming.size, incoming.valid_nodes = found


async def _write(request: Request, write: Sink) -> None:
    """Write what the body decodes to: the header at once, as it may be wrong, and then in larger pieces."""
    feed, finish = decoder(encoding_of(request), write, FILE_SIZE)
    piece, enough = bytearray(), HEADER_SIZE
    async for part in request.stream():
        piece += part
        if len(piece) >= enough:
            await in_thread(feed, bytes(piece))
            piece, enough = bytearray(), _PIECE
    await in_thread(feed, bytes(piece))
    await in_thread(finish)


def _check_longest(n_bytes: int, kind: Kind | None) -> None:
    """Raise ProblemError if a file of a kind, None being MERL, may not have so many bytes."""
    if kind is not None and n_bytes > MOST_CONVERTED:
        most = f"A .bsdf file or a table has at most {MOST_CONVERTED} bytes here, and this one is longer."
        raise ProblemError("measurement-too-large", most)
    if n_bytes > FILE_SIZE:
        try:
            check_length(n_bytes)
        except MeasurementFormatError as error:  # the library's sentence, with a kind of its own
            raise ProblemError("measurement-too-large", str(error)) from None
