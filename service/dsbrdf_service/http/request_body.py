"""Receive request bodies, which may be compressed with gzip: measurements as a stream, other bodies whole."""

import zlib
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from ..access.authentication import CALLER_NAME
from ..errors import ProblemError

PIECE = 1 << 16
_MAX_HELD_BYTES = 64_000_000  # If unanswered bodies of a caller exceed this size, the next body is refused.


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
    """Receive request bodies into memory, of which each caller may use a limited amount."""

    def __init__(self) -> None:
        self._held: Counter[str] = Counter()  # Bytes of bodies in memory, by caller.

    @asynccontextmanager
    async def received(self, request: Request, limit: int) -> AsyncIterator[bytes]:
        """Yield the decoded body of a request, of at most `limit` bytes.

        Raises the errors of `decoded`, and ProblemError if the caller's bodies together take too much memory.
        """
        caller, content = request.scope[CALLER_NAME], bytearray()
        try:
            async for piece in decoded(request, limit):
                if len(content) + len(piece) > limit:
                    raise _too_large(limit)
                if self._held[caller] + len(piece) > _MAX_HELD_BYTES:
                    most = f"{_MAX_HELD_BYTES // 10**6} MB, the most allowed"
                    detail = f"The bodies of your requests take {most}; wait until some are answered."
                    raise ProblemError("too-many-at-once", detail, {"Connection": "close"})
                self._held[caller] += len(piece)
                content += piece
            yield bytes(content)
        finally:
            self._held[caller] -= len(content)
            self._held += Counter()  # Adding a counter removes callers with 0 bytes.


async def decoded(request: Request, limit: int) -> AsyncIterator[bytes]:
    """Yield the decoded body in pieces; a piece of a compressed body has at most `PIECE` bytes.

    Raises ProblemError if the encoding is unknown, if the body is damaged, or if it is longer than any encoding of
    `limit` bytes. The caller must bound the length of the decoded body, which can be much longer.
    """
    names = ",".join(request.headers.getlist("content-encoding")).lower().split(",")
    encoding = ", ".join(name for part in names if (name := part.strip()) not in ("", "identity"))
    if encoding not in ("", "gzip", "x-gzip"):
        detail = f"The content encoding {encoding[:40]!r} is not supported; send the body uncompressed or as gzip."
        raise ProblemError("unsupported-media-type", detail, {"Accept-Encoding": "gzip"})
    member, left = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS), limit + limit // 64 + 1024
    async for piece in request.stream():
        left -= len(piece)
        if left < 0:  # The encoded length is limited too, because an endless gzip body can decode to nothing.
            raise _too_large(limit)
        if not encoding:
            yield piece
            continue
        while piece:
            if member.eof:
                raise _damaged("it goes on after its end")
            try:
                content = await run_in_threadpool(member.decompress, piece, PIECE)
            except zlib.error as error:
                raise _damaged(str(error)) from None
            yield content
            piece = member.unconsumed_tail or member.unused_data
    if encoding and not member.eof:
        raise _damaged("it is cut off")


def _too_large(limit: int) -> ProblemError:
    return ProblemError("too-large", f"The body is longer than the {limit} bytes that it may have here.")


def _damaged(reason: str) -> ProblemError:
    return ProblemError("bad-encoding", f"The body is not valid gzip: {reason[:200]}.")
