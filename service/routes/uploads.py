"""Uploads of measurements: MERL files, RGL ``.bsdf`` files, and tables of samples as text."""

from pathlib import Path
from typing import Any

from fastapi import Request

from dsbrdf.data.merl_validation import FILE_SIZE
from dsbrdf.data.scattered_samples import TABLE_SUFFIXES
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError

from ..http import openapi
from ..http.openapi import BINARY
from ..http.request_body import upload_body
from ..storage.conversions import Converted, Kind, conversion_step
from ..storage.schema import Caller, MeasurementRow
from ..wire.names import MAX_LENGTH
from .dependencies import Context, name_of

TEXTS = ("text/csv", "text/tab-separated-values", "text/plain")
UPLOADED = (BINARY, *TEXTS)
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
    openapi.header_parameter(
        "Content-Encoding", "The body may be compressed.", enum=["identity", "gzip", "x-gzip", "zstd"]
    ),
]
CONTENT: dict[str, Any] = {media_type: openapi.file(media_type, maxLength=FILE_SIZE) for media_type in UPLOADED}


async def receive_upload(
    request: Request, context: Context, caller: Caller, media_type: str
) -> tuple[MeasurementRow, bool]:
    """Store the measurement that is the body; the flag says whether it is new to the caller.

    Raises MeasurementFormatError if it is not an acceptable measurement of its kind; further errors are those of
    `Store.receive_measurement`.
    """
    name = name_of(request)
    kind = _SUFFIXES.get(Path(name or "").suffix.lower())
    if name is not None and kind is not None:
        name = Path(name).stem
    kind = "samples" if media_type in TEXTS else kind

    async def convert(path: Path) -> Converted:
        key = ("upload", path)
        try:
            found: Converted = await context.computations.run_in_process(
                request, key, conversion_step, path, kind, head={}, place="long"
            )
        except InvalidArgumentError as error:  # as every fault of a step's arguments
            raise MeasurementFormatError(str(error)) from None
        return found

    with context.metrics.timing("upload"):
        return await context.store.receive_measurement(caller, upload_body(request), name, convert if kind else None)
