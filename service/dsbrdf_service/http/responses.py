"""Responses: JSON documents with strong ETags, files, links to the next page, and the headers that every one has."""

import hashlib
import json
import logging
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from pydantic import BaseModel
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.types import Message, Receive, Scope, Send

from ..errors import ProblemError
from ..storage.schema import FitRow, MeasurementRow
from ..wire.points import JSON
from ..wire.schemas import Page

logger = logging.getLogger(__name__)

_SECURITY_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"vary", b"Authorization"),
)
# Of the headers that a response may give itself: the page of the documentation has a policy of its own.
_DEFAULT_HEADERS = (
    (b"content-security-policy", b"default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"),
    # Kept by the client that has asked, for its If-None-Match, and not used again without asking.
    (b"cache-control", b"private, no-cache"),
)
_WAIT = re.compile(r'(?:^|,)\s*wait\s*=\s*"?([0-9]{1,9}(?:\.[0-9]{1,9})?)"?\s*(?:[,;]|$)', re.IGNORECASE)
_ASYNC = re.compile(r"(?:^|,)\s*respond-async\s*(?:[,;]|$)", re.IGNORECASE)
_PREFIX = re.compile(r"(?:/[A-Za-z0-9._~-]{1,100}){1,10}")
_QUALITY = re.compile(r"(?:^|;)\s*q\s*=\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*(?:;|$)")
_RANGE = re.compile(r"bytes=(?=[0-9]|-[0-9])([0-9]{0,18})-([0-9]{0,18})", re.IGNORECASE)


def with_security_headers(headers: Iterable[tuple[bytes, bytes]]) -> list[tuple[bytes, bytes]]:
    """Return the headers of a response with those that tell browsers and caches what they must not do with it.

    Nothing in it may run, be framed, be read by a page of another site, or be shown to someone who has not asked with
    the same key.
    """
    complete = [*headers, *_SECURITY_HEADERS]
    given = {name for name, _ in complete}
    complete += [header for header in _DEFAULT_HEADERS if header[0] not in given]
    return complete


def prefix_of(request: Request) -> str:
    """Return the path below which a proxy shows the service, as it says with ``X-Forwarded-Prefix``.

    Any client may send this header; it changes only the addresses in this answer.
    """
    given = request.headers.get("x-forwarded-prefix", "").rstrip("/")
    return given if _PREFIX.fullmatch(given) else ""


def json_reply(document: BaseModel, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """Return `document` as a JSON response."""
    return Response(document.model_dump_json(), status, dict(headers or {}), JSON)


def tagged_reply(
    request: Request,
    content: bytes | BaseModel | dict[str, Any],
    media_type: str = JSON,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return bytes, a document or JSON's types with their hash as a strong ETag, or 304 if the client has them."""
    if isinstance(content, BaseModel):
        content = content.model_dump_json().encode()
    elif isinstance(content, dict):
        content = json.dumps(content, allow_nan=False).encode()
    tagged = {**(headers or {}), "ETag": tag_of(content)}
    return not_modified(request, tagged) or Response(content, 200, tagged, media_type)


def tag_of(content: bytes) -> str:
    """Return the strong ETag of bytes: those of an answer, or of what determines it."""
    return f'"{hashlib.sha256(content).hexdigest()[:32]}"'


def not_modified(request: Request, headers: Mapping[str, str]) -> Response | None:
    """Return the answer 304 if ``If-None-Match`` has the ETag of `headers`: what the client has is current."""
    given = [part.strip() for part in ",".join(request.headers.getlist("if-none-match")).split(",")]
    is_current = given == ["*"] or headers["ETag"] in (part.removeprefix("W/") for part in given)
    return Response(None, 304, dict(headers)) if is_current else None


class OpenFileResponse(FileResponse):
    """A file that is open before anything is sent, so that it is sent to its end even if it is deleted meanwhile.

    If the whole of it has not the digest `sha256`, its last piece is kept back, which breaks the connection: the client
    learns that it has not got what the ETag says. Raises FileNotFoundError if the file has been deleted already.
    """

    def __init__(self, path: Path, headers: Mapping[str, str], media_type: str, sha256: str) -> None:
        self._sha256 = sha256
        self._file = path.open("rb")
        number = self._file.fileno()
        super().__init__(
            f"/dev/fd/{number}",
            headers=headers,
            media_type=media_type,
            stat_result=os.fstat(number),
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file, or the part of it that is asked for."""
        digest = hashlib.sha256()
        held: Message | None = None
        status = 0

        async def hold_back(message: Message) -> None:
            nonlocal held, status
            if held is not None:
                await send(held)
            held, status = message, message.get("status", status)
            digest.update(message.get("body", b""))

        with self._file:
            await super().__call__(scope, receive, hold_back)
        if held is None or held.get("more_body", True):  # the client has gone
            return
        if status == 200 and digest.hexdigest() != self._sha256:
            logger.error("the file of the measurement %s has changed while it was sent", self._sha256)
        else:
            await send(held)


class MadeFileResponse(FileResponse):
    """A file without a name, which has been made for the requests that are answered with it; it `keeps` it open."""

    def __init__(self, descriptor: int, keeps: object, headers: Mapping[str, str]) -> None:
        super().__init__(f"/dev/fd/{descriptor}", headers=headers, stat_result=os.fstat(descriptor))
        self._keeps = keeps
        for name in ("etag", "last-modified", "accept-ranges"):  # of this file, which the next request does not get
            del self.headers[name]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the whole file."""
        headers = [header for header in scope["headers"] if header[0] != b"range"]
        await super().__call__({**scope, "headers": headers}, receive, send)


def check_range(request: Request, size: int) -> None:
    """Check that a file of `size` bytes has the range of bytes that the request asks for (RFC 9110, section 14.2).

    A ``Range`` that is not one range of bytes is ignored: it is removed from the request.

    Raises ProblemError if the range begins beyond the end.
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


def next_page(request: Request, page: Page, rows: Sequence[FitRow | MeasurementRow]) -> dict[str, str]:
    """Return the ``Link`` header to the next page; `rows` has one row more than a page unless this is the last one."""
    if len(rows) <= page.limit:
        return {}
    names = {} if page.name is None else {"name": page.name}
    query = urlencode({"limit": page.limit, "cursor": rows[page.limit - 1].seq, **names})
    return {"Link": f'<{prefix_of(request)}{request.url.path}?{query}>; rel="next"'}


def preferred_wait(request: Request, default: float, longest: float) -> float:
    """Return the time to wait that ``Prefer`` asks for (RFC 7240) [s]; other preferences are ignored.

    With ``wait``, ``respond-async`` changes nothing: it says what to do when that time is over, which happens anyway.
    """
    given = ",".join(request.headers.getlist("prefer"))
    if wait := _WAIT.search(given):
        return min(float(wait[1]), longest)
    return 0.0 if _ASYNC.search(given) else min(default, longest)


def accepted_type(request: Request, first: str, second: str) -> str | None:
    """Return which of two media types ``Accept`` prefers, the first where it takes both alike; None if neither.

    A quality of the type itself counts before that of a range.
    """
    ranges: dict[str, float] = {}
    for entry in ",".join(request.headers.getlist("accept")).lower().split(","):
        media_type, _, parameters = entry.partition(";")
        quality = _QUALITY.search(parameters)
        if media_type.strip():
            weight = min(float(quality[1]), 1.0) if quality else 1.0
            ranges[media_type.strip()] = max(ranges.get(media_type.strip(), 0.0), weight)

    of_range = ranges.get("application/*", ranges.get("*/*", 0.0 if ranges else 1.0))
    # A type that is named counts more.
    for_first, for_second = ranges.get(first, 0.5 * of_range), ranges.get(second, 0.25 * of_range)
    if not (for_first or for_second):
        return None
    return second if for_second > for_first else first
