"""Make responses with strong ETags or from open files, and read the request headers that affect responses."""

import hashlib
import re
from collections.abc import Mapping
from functools import partial

from anyio import CapacityLimiter, to_thread
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from ..storage.blobs import OpenFile
from ..storage.schema import Caller
from ..storage.writing import Writing

BINARY = "application/octet-stream"
JSON = "application/json"
NPY = "application/x-npy"
PIECE_BYTES = 1 << 16
"""Length of the pieces of an answer [bytes]: a connection with a slow client keeps two pieces in memory."""
_MAX_HELD_BYTES = 1 << 18  # A longer answer is sent from a temporary file, so that it does not stay in memory.
# Files are read in their own threads, so that no other request waits for the pieces of many answers.
_read_in_thread = partial(to_thread.run_sync, limiter=CapacityLimiter(2))
_WAIT = re.compile(r'(?:^|,)\s*wait\s*=\s*"?([0-9]{1,9}(?:\.[0-9]{1,9})?)"?\s*(?:[,;]|$)', re.IGNORECASE)
_ASYNC = re.compile(r"(?:^|,)\s*respond-async\s*(?:[,;]|$)", re.IGNORECASE)
_PREFIX = re.compile(r"(?:/[A-Za-z0-9._~-]{1,100}){1,10}")


def prefix_of(request: Request) -> str:
    """Return the path below which a proxy shows the service, from the header ``X-Forwarded-Prefix``.

    Any client may send this header; it changes only the addresses in this answer.
    """
    given = request.headers.get("x-forwarded-prefix", "").rstrip("/")
    return given if _PREFIX.fullmatch(given) else ""


def tagged_reply(
    request: Request, content: bytes, media_type: str = JSON, headers: Mapping[str, str] | None = None
) -> Response:
    """Return a response of bytes with their hash as a strong ETag, or 304 if the client has these bytes."""
    tagged = {**(headers or {}), "ETag": tag_of(content)}
    return not_modified(request, tagged) or Response(content, 200, tagged, media_type)


def tag_of(content: bytes) -> str:
    """Return the strong ETag of an answer from its content, or from data that determine the content."""
    return f'"{hashlib.sha256(content).hexdigest()[:32]}"'


def not_modified(request: Request, headers: Mapping[str, str]) -> Response | None:
    """Return the answer 304 if the ETag in `headers` is in ``If-None-Match``, so the client has the current content."""
    given = [part.strip() for part in ",".join(request.headers.getlist("if-none-match")).split(",")]
    is_current = given == ["*"] or headers["ETag"] in (part.removeprefix("W/") for part in given)
    return Response(None, 304, dict(headers)) if is_current else None


class OpenFileResponse(Response):
    """Send an open file to its end, even if it is deleted meanwhile."""

    def __init__(self, file: OpenFile, headers: Mapping[str, str]) -> None:
        self._file, self._size = file, file.size
        super().__init__(headers={**headers, "Content-Length": str(self._size)})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG002 (ASGI's signature)
        """Send the file."""
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        n_sent, is_last = 0, False
        while not is_last:
            piece = await _read_in_thread(self._file.read, PIECE_BYTES, n_sent)
            n_sent += len(piece)
            is_last = n_sent >= self._size or not piece
            await send({"type": "http.response.body", "body": piece, "more_body": not is_last})


async def long_reply(writing: Writing, caller: Caller, content: bytes, headers: Mapping[str, str]) -> Response:
    """Return an answer with the given content and headers; a long answer is sent from a temporary file."""
    if len(content) <= _MAX_HELD_BYTES:
        return Response(content, 200, dict(headers))
    return OpenFileResponse(await writing.answer_with(caller, content), headers)


def preferred_wait(request: Request, default: float, longest: float) -> float:
    """Return the time to wait that ``Prefer`` asks for (RFC 7240) [s]; other preferences are ignored.

    With ``wait``, ``respond-async`` changes nothing, because the answer is asynchronous anyway when the time is over.
    """
    given = ",".join(request.headers.getlist("prefer"))
    if wait := _WAIT.search(given):
        return min(float(wait[1]), longest)
    return 0.0 if _ASYNC.search(given) else min(default, longest)


def prefers(request: Request, wanted: str, other: str) -> bool:
    """Return whether ``Accept`` names the media type `wanted`, and not `other` before it; weights are ignored."""
    accepted = ",".join(request.headers.getlist("accept")).lower()
    return re.findall(f"{re.escape(wanted)}|{re.escape(other)}", accepted)[:1] == [wanted]
