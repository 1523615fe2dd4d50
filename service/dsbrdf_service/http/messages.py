"""Read names, bodies and preferences of requests, and make responses with strong ETags or from open files.

Lists and exported files have the names that clients give to measurements and fits. A name does not identify a
measurement: a measurement that is sent again under another name is renamed.
"""

import hashlib
import re
from collections import Counter
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from email.message import Message
from email.utils import collapse_rfc2231_value
from functools import partial
from urllib.parse import quote

from anyio import CapacityLimiter, to_thread
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from dsbrdf.errors import InvalidArgumentError

from ..access import CALLER_NAME
from ..errors import ProblemError
from ..storage.files import OpenFile, Writing
from ..storage.schema import Caller
from ..wire import check_name

_SUFFIX = ".binary"
_MAX_HEADER_LENGTH = 1024  # [characters] A longer Content-Disposition is refused.
_MAX_BODIES_BYTES = 64_000_000  # If unanswered bodies of a caller exceed this size, the next body is refused.
BINARY = "application/octet-stream"
JSON = "application/json"
NPY = "application/x-npy"
PIECE_BYTES = 1 << 16
"""Length of the pieces of an answer [bytes]: a connection with a slow client keeps two pieces in memory."""
_MAX_REPLY_BYTES = 1 << 18  # A longer answer is sent from a temporary file, so that it does not stay in memory.
# Files are read in their own threads, so that no other request waits for the pieces of many answers.
_read_in_thread = partial(to_thread.run_sync, limiter=CapacityLimiter(2))
_WAIT = re.compile(r'(?:^|,)\s*wait\s*=\s*"?([0-9]{1,9}(?:\.[0-9]{1,9})?)"?\s*(?:[,;]|$)', re.IGNORECASE)
_ASYNC = re.compile(r"(?:^|,)\s*respond-async\s*(?:[,;]|$)", re.IGNORECASE)
_PREFIX = re.compile(r"(?:/[A-Za-z0-9._~-]{1,100}){1,10}")


def given_name(request: Request) -> str | None:
    """Return the name that a request gives to its upload or fit, if any.

    The name is the parameter `name` of the query, or the file name in ``Content-Disposition`` (RFC 6266).

    Raises InvalidArgumentError if the name is not valid.
    """
    if "name" in request.query_params:
        return check_name(request.query_params["name"])
    header = request.headers.get("content-disposition")
    name = _file_name(header) if header else None
    # The folder in a file name is removed, because it means nothing to the service.
    return None if name is None else check_name(re.split(r"[/\\]", name)[-1].removesuffix(_SUFFIX))


def _file_name(header: str) -> str | None:
    """Return the file name in a ``Content-Disposition``, preferably ``filename*`` (RFC 8187)."""
    if len(header) > _MAX_HEADER_LENGTH:  # The parser takes a time that grows with the square of the length.
        raise InvalidArgumentError(f"A Content-Disposition has at most {_MAX_HEADER_LENGTH} characters.")
    message = Message()
    message["Content-Disposition"] = header
    parameters = dict(message.get_params([], "content-disposition"))  # The parser puts `filename*` last.
    if "filename" not in parameters:
        return None
    name = None
    with suppress(UnicodeError):
        name = collapse_rfc2231_value(parameters["filename"])
        name = name.encode("latin-1").decode()  # Many programs send UTF-8, although headers are decoded as Latin-1.
    return name


def content_disposition(file_name: str) -> str:
    """Return the ``Content-Disposition`` that saves a file under a name (RFC 6266)."""
    encoded = quote(file_name, safe="")
    plain = f'filename="{file_name}"' if encoded == file_name else f"filename*=UTF-8''{encoded}"
    return f"attachment; {plain}"


def media_type_of(request: Request, *supported: str) -> str:
    """Return the media type of the body; without a header, the first of the types `supported`.

    Raises ProblemError if the type is not supported.
    """
    media_type = request.headers.get("content-type", supported[0]).partition(";")[0].strip().lower()
    if media_type not in supported:
        alone = f"send the file or document alone as the body, with one of {', '.join(supported)}"
        if media_type == "application/x-www-form-urlencoded":  # curl sends this type with --data-binary.
            alone = f"add --header 'Content-Type: {supported[0]}', or another of {', '.join(supported[1:])}"
        detail = f"The content type {media_type[:60]!r} is not supported here; {alone}."
        raise ProblemError("unsupported-media-type", detail, {"Accept-Post": ", ".join(supported)})
    return media_type


class Bodies:
    """Receive request bodies into memory, and limit the amount that each caller may use."""

    def __init__(self) -> None:
        self._held: Counter[str] = Counter()  # Bytes of bodies in memory, by caller.

    @asynccontextmanager
    async def received(self, request: Request, limit: int) -> AsyncIterator[bytes]:
        """Yield the body of a request.

        Raises ProblemError as `pieces_of`, if the body is longer than `limit` bytes, or if the caller's bodies together
        take too much memory.
        """
        caller, content = request.scope[CALLER_NAME], bytearray()
        try:
            async for piece in pieces_of(request):
                if len(content) + len(piece) > limit:
                    raise ProblemError("too-large", f"The body is longer than the {limit} bytes that it may have here.")
                if self._held[caller] + len(piece) > _MAX_BODIES_BYTES:
                    most = f"{_MAX_BODIES_BYTES // 10**6} MB, the most allowed"
                    detail = f"The bodies of your requests take {most}; wait until some are answered."
                    raise ProblemError("too-many-at-once", detail, {"Connection": "close"})
                self._held[caller] += len(piece)
                content += piece
            yield bytes(content)
        finally:
            self._held[caller] -= len(content)
            self._held += Counter()  # Adding an empty counter drops callers with 0 bytes.


async def pieces_of(request: Request) -> AsyncIterator[bytes]:
    """Yield the body in pieces as they come; raise ProblemError if the body is encoded."""
    encoding = request.headers.get("content-encoding", "").strip().lower()
    if encoding not in ("", "identity"):
        detail = f"The content encoding {encoding[:40]!r} is not supported; send the body without one."
        raise ProblemError("unsupported-media-type", detail, {"Accept-Encoding": "identity"})
    async for piece in request.stream():
        yield piece


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
    if len(content) <= _MAX_REPLY_BYTES:
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
