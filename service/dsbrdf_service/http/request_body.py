"""Request bodies and their one encoding, gzip: measurements as a stream, other bodies whole.

A decoder is given the body in pieces and passes decoded pieces of at most `PIECE` bytes to a sink, which raises as
soon as it has enough: a small body that decodes to a huge one costs no more memory or time than the limit.
"""

import zlib
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from ..access.authentication import CALLER_NAME
from ..errors import ProblemError

Sink = Callable[[bytes], None]

PIECE = 1 << 18
_MOST_HELD = 64_000_000  # bytes of bodies that one caller may have in memory


def media_type_of(request: Request, *supported: str) -> str:
    """Return the media type of the body, which is the first of those `supported` unless the request says otherwise.

    Raises ProblemError if it is another one.
    """
    media_type = request.headers.get("content-type", supported[0]).partition(";")[0].strip().lower()
    if media_type not in supported:
        detail = f"The content type {media_type[:60]!r} is not supported; send {' or '.join(supported)}."
        if media_type.startswith("multipart/"):
            detail = (
                f"A form is not supported; send the file alone as the body, as {' or '.join(supported)}: with curl, "
                "--data-binary @FILE instead of --form."
            )
        raise ProblemError("unsupported-media-type", detail, {"Accept-Post": ", ".join(supported)})
    return media_type


class Bodies:
    """Bodies in memory; a caller who has too much of them there has to wait."""

    def __init__(self) -> None:
        self._held: Counter[str] = Counter()  # bytes, by caller

    @asynccontextmanager
    async def received(self, request: Request, limit: int) -> AsyncIterator[bytes]:
        """Yield the decoded body of a request, of at most `limit` bytes; it counts until the end of the block.

        Raises ProblemError if it is longer, its encoding is unknown or damaged, or it is too much with the caller's
        other bodies.
        """
        encoding, caller, content = encoding_of(request), request.scope[CALLER_NAME], bytearray()

        def keep(data: bytes) -> None:
            if len(content) + len(data) > limit:
                raise _too_large(limit)
            if self._held[caller] + len(data) > _MOST_HELD:
                most = f"{_MOST_HELD // 10**6} MB, the most allowed"
                detail = f"Bodies of this caller's requests take {most}; wait for some to be answered."
                raise ProblemError("too-many-at-once", detail, {"Connection": "close"})
            self._held[caller] += len(data)
            content.extend(data)

        feed, finish = decoder(encoding, keep, limit)
        declared = request.headers.get("content-length", "")
        if declared.isdecimal() and int(declared) > _most_encoded(limit):
            raise _too_large(limit)
        try:
            async for piece in request.stream():
                if encoding:  # few bytes can decode to many
                    await run_in_threadpool(feed, piece)
                else:
                    feed(piece)
            if encoding:
                await run_in_threadpool(finish)
            yield bytes(content)
        finally:
            self._held[caller] -= len(content)
            self._held += Counter()  # without those that have none


def _most_encoded(limit: int) -> int:
    """Return the most bytes that `limit` bytes may have when they are encoded; compressors add less."""
    return limit + limit // 64 + 1024


def _too_large(limit: int) -> ProblemError:
    return ProblemError("too-large", f"The body is longer than the {limit} bytes that it may have here.")


def decoder(content_encoding: str, sink: Sink, limit: int) -> tuple[Sink, Callable[[], None]]:
    """Return what takes a body with this ``Content-Encoding`` in pieces, and what takes its end.

    Raises ProblemError if it is not one that the service decodes. What it returns does so if the body is damaged, or
    longer than `limit` bytes can be when they are encoded; the `sink` looks at those that are decoded.
    """
    if not content_encoding:
        return sink, lambda: None
    if content_encoding not in ("gzip", "x-gzip"):
        detail = f"The content encoding {content_encoding[:40]!r} is not supported; send the body as it is, or as gzip."
        raise ProblemError("unsupported-media-type", detail, {"Accept-Encoding": "gzip"})
    member = _GzipDecoder(sink, limit)
    return member.feed, member.finish


class _GzipDecoder:
    """Decodes one gzip member (RFC 1952)."""

    def __init__(self, sink: Sink, limit: int) -> None:
        self._sink = sink
        self._limit = limit
        self._n_encoded = 0
        self._member = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)

    def feed(self, data: bytes) -> None:
        self._n_encoded += len(data)
        if self._n_encoded > _most_encoded(self._limit):  # what decodes to nothing could go on
            raise _too_large(self._limit)
        while data:
            if self._member.eof:
                raise _damaged("it goes on after its end")
            try:
                decoded = self._member.decompress(data, PIECE)
            except zlib.error as error:
                raise _damaged(str(error)) from None
            if decoded:
                self._sink(decoded)
            data = self._member.unconsumed_tail or self._member.unused_data

    def finish(self) -> None:
        if not self._member.eof:
            raise _damaged("it is cut off")


def _damaged(reason: str) -> ProblemError:
    return ProblemError("bad-encoding", f"The body is not valid gzip: {reason[:200]}.")


def encoding_of(request: Request) -> str:
    """Return the ``Content-Encoding`` of the body, for `decoder`; empty if there is none."""
    given = ",".join(request.headers.getlist("content-encoding")).lower().split(",")
    return ", ".join(name for part in given if (name := part.strip()) not in ("", "identity"))
