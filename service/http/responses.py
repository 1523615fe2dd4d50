"""Responses: JSON documents with strong ETags, pages with links, and the waiting that a request prefers."""

import hashlib
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlencode

from pydantic import BaseModel
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.types import Receive, Scope, Send

from service.http.problems import ProblemError

JSON = "application/json"
_PREFERENCE = re.compile(r'(?:[^,"]|"[^"]*"|")+')  # a comma in quotes separates nothing
_RANGE = re.compile(r"bytes=(?=[0-9]|-[0-9])([0-9]{0,18})-([0-9]{0,18})", re.IGNORECASE)


def json_reply(document: BaseModel, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """Return `document` as a JSON response."""
    return Response(document.model_dump_json(), status, dict(headers or {}), JSON)


def tagged_reply(
    request: Request,
    content: bytes,
    tag: str | None = None,
    media_type: str = JSON,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return `content` with a strong ETag, or 304 if the client has it; the tag is by default its hash."""
    etag = f'"{tag or hashlib.sha256(content).hexdigest()[:32]}"'
    every = {**(headers or {}), "ETag": etag}
    if not_modified(request, etag):
        return Response(None, 304, every)
    return Response(content, 200, every, media_type)


def not_modified(request: Request, etag: str) -> bool:
    """Return whether the client already has what `etag` names."""
    candidates = request.headers.get("if-none-match", "")
    return candidates.strip() == "*" or etag in (part.strip().removeprefix("W/") for part in candidates.split(","))


class OpenFileResponse(FileResponse):
    """A file that is open before anything is sent, so that it is sent to its end even if it is deleted meanwhile.

    Parameters
    ----------
    path : Path
    headers : mapping
    media_type : str

    Raises
    ------
    FileNotFoundError
        If it has been deleted already.
    """

    def __init__(self, path: Path, headers: Mapping[str, str], media_type: str) -> None:
        self._file = path.open("rb")
        number = self._file.fileno()
        super().__init__(
            f"/dev/fd/{number}",
            headers=headers,
            media_type=media_type,
            filename=path.name,
            stat_result=os.fstat(number),
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file, or the part of it that is asked for."""
        with self._file:
            await super().__call__(scope, receive, send)


def check_range(request: Request, size: int) -> None:
    """Make sure that a ``Range`` is one that a file of `size` bytes can be sent by (RFC 9110, section 14.2).

    What is not one range of bytes is taken out of the request, as if it had not been there.

    Raises
    ------
    ProblemError
        If the range begins beyond the end.
    """
    found = _RANGE.fullmatch(request.headers.get("range", ""))
    first, last = (found[1], found[2]) if found else ("", "")
    if first and last and int(last) < int(first):
        found = None
    if found is None:
        request.scope["headers"] = [header for header in request.scope["headers"] if header[0] != b"range"]
    elif (first and int(first) >= size) or (not first and int(last) == 0):
        detail = f"The range begins beyond the end of the file, which has {size} bytes."
        raise ProblemError("range-not-satisfiable", detail, {"Content-Range": f"bytes */{size}"})


def next_page(request: Request, limit: int, rows: int, last: int | None) -> dict[str, str]:
    """Return the ``Link`` header to the page after one of `rows` rows that ends with the row number `last`."""
    if last is None or rows < limit:
        return {}
    query = urlencode({"limit": limit, "cursor": last})
    return {"Link": f'<{request.url.path}?{query}>; rel="next"'}


def preferred_wait(request: Request, default: float, longest: float) -> float:
    """Return the time to wait that ``Prefer`` asks for (RFC 7240); what it says of other things is ignored.

    Of a preference that is given more than once the first counts. ``respond-async`` beside ``wait`` changes nothing:
    the answer does not wait for the fit any longer either way.
    """
    preferences: dict[str, str] = {}
    for preference in _PREFERENCE.findall(",".join(request.headers.getlist("prefer"))):
        name, _, value = preference.partition(";")[0].partition("=")
        preferences.setdefault(name.strip().lower(), value.strip().strip('"'))
    otherwise = 0.0 if "respond-async" in preferences else default
    return min(_seconds(preferences.get("wait", ""), otherwise), longest)


def _seconds(text: str, otherwise: float) -> float:
    try:
        seconds = float(text)
    except ValueError:
        return otherwise
    return seconds if math.isfinite(seconds) and seconds >= 0 else otherwise
