"""Request bodies and their encodings: measurements as a stream, other bodies whole, long ones in a temporary file.

A decoder is given the body in pieces and passes decoded pieces of at most `PIECE` bytes to a sink, which raises as
soon as it has enough: a small body that decodes to a huge one costs no more memory or time than the limit.
"""

import mmap
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import Any

from backports import zstd
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from ..errors import ProblemError

Sink = Callable[[bytes], None]

PIECE = 1 << 18
IN_MEMORY = 1 << 16  # bytes of a body that are kept in memory
_BLOCK = 1 << 14  # encoded bytes that are decoded at a time, so that the answer does not depend on how a body was cut
_MAX_MEMBERS = 10_000
_ZSTD_WINDOW_LOG = 23  # 8 MiB, what RFC 9659 asks every decoder of zstd content to support


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


async def receive_body(request: Request, limit: int, folder: Path) -> bytes | mmap.mmap:
    """Return the decoded body of `request`, of at most `limit` bytes; a long one is in a temporary file in `folder`.

    So many bodies that arrive slowly take little memory.

    Raises ProblemError if it is longer, or its encoding is unknown or damaged.
    """
    too_large = ProblemError("too-large", f"The body is longer than the {limit} bytes that it may have here.")
    with SpooledTemporaryFile(IN_MEMORY, dir=str(folder)) as file:

        def keep(data: bytes) -> None:
            if file.tell() + len(data) > limit:
                raise too_large
            file.write(data)

        feed, finish = decoder(encoding_of(request), keep)
        declared = request.headers.get("content-length", "")
        if declared.isdecimal() and int(declared) > limit:
            raise too_large
        n_encoded = 0
        async for piece in request.stream():
            n_encoded += len(piece)
            if n_encoded > limit + limit // 64 + 1024:  # compressors add less; what decodes to nothing could go on
                raise too_large
            if n_encoded > IN_MEMORY:
                await run_in_threadpool(feed, piece)
            else:
                feed(piece)
        finish()
        size = file.tell()
        if size > IN_MEMORY:
            file.flush()
            return mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
        file.seek(0)
        return file.read()


def decoder(content_encoding: str, sink: Sink) -> tuple[Sink, Callable[[], None]]:
    """Return what takes a body with this ``Content-Encoding``, which may name one, in pieces, and what takes its end.

    Raises ProblemError if it is not one that the service decodes.
    """
    given = (name.strip().lower() for name in content_encoding.split(","))
    name = ", ".join(name for name in given if name not in ("", "identity"))
    if not name:
        return sink, lambda: None
    if name in ("gzip", "x-gzip"):
        members = _MemberDecoder("gzip", partial(zlib.decompressobj, wbits=16 + zlib.MAX_WBITS), sink)
    elif name == "zstd":
        options = {int(zstd.DecompressionParameter.window_log_max): _ZSTD_WINDOW_LOG}
        members = _MemberDecoder("zstd", partial(zstd.ZstdDecompressor, options=options), sink)
    else:
        detail = f"The content encoding {name[:40]!r} is not supported; send the body as it is, or as gzip or zstd."
        raise ProblemError("unsupported-media-type", detail, {"Accept-Encoding": "gzip, zstd"})
    return members.feed, members.finish


class _MemberDecoder:
    """One gzip member (RFC 1952) or zstd frame (RFC 8878), or several one after the other.

    `new_member` makes a decompressor with ``decompress(data, max_length)``, ``eof`` and ``unused_data``.
    """

    def __init__(self, name: str, new_member: Callable[[], Any], sink: Sink) -> None:
        self._name = name
        self._new_member = new_member
        self._sink = sink
        self._member = new_member()
        self._n_members = 1
        self._inside = False  # a member, after its first byte
        self._waiting = bytearray()

    def feed(self, data: bytes) -> None:
        self._waiting += data
        for start in range(0, len(self._waiting) - _BLOCK + 1, _BLOCK):
            self._decode(self._waiting[start : start + _BLOCK])
        del self._waiting[: len(self._waiting) // _BLOCK * _BLOCK]

    def finish(self) -> None:
        if self._waiting:
            self._decode(self._waiting)
        if self._inside:
            raise self._damaged("it is cut off")

    def _decode(self, data: bytes | bytearray) -> None:
        self._inside = True
        while True:
            try:
                decoded = self._member.decompress(data, PIECE)
            except (zlib.error, zstd.ZstdError) as error:
                raise self._damaged(_reason(error)) from None
            if decoded:
                self._sink(decoded)
            if self._member.eof:
                data = self._member.unused_data
                self._inside = bool(data)
                self._n_members += 1
                if self._n_members > _MAX_MEMBERS:
                    raise self._damaged(f"it has more than {_MAX_MEMBERS} members")
                self._member = self._new_member()
                if not data:
                    return
            elif len(decoded) < PIECE:
                return
            else:  # there may be more output; zstd keeps the rest of the input itself
                data = getattr(self._member, "unconsumed_tail", b"")

    def _damaged(self, reason: str) -> ProblemError:
        return ProblemError("bad-encoding", f"The body is not valid {self._name}: {reason[:200]}.")


def _reason(error: Exception) -> str:
    """Return what is wrong with a member; zstd's own sentence about a damaged frame is long and says no more."""
    if isinstance(error, zlib.error):
        return str(error)
    if "too much memory" in str(error):
        return f"its window is larger than {1 << _ZSTD_WINDOW_LOG} bytes, as from levels above 19 or with --long"
    return "it needs a dictionary" if "ictionary" in str(error) else "it is damaged"


def encoding_of(request: Request) -> str:
    """Return the ``Content-Encoding`` of the body, for `decoder`."""
    return ", ".join(request.headers.getlist("content-encoding"))
