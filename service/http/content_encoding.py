"""Content encodings of a request body, decoded in bounded memory.

A decoder is fed the body piece by piece and passes decoded pieces of at most `PIECE` bytes to a sink, which
raises as soon as it has enough; so a small body that decodes to a huge one costs no more than the limit.
"""

import zlib
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Protocol, cast

import zstandard

from service.http.problems import ProblemError

PIECE = 1 << 18
_BLOCK = 1 << 16
_MOST_MEMBERS = 10_000
_LARGEST_WINDOW = 1 << 23  # what RFC 9659 asks every decoder of zstd content to support
_LAST_WORD = b"the end"
_LAST_FRAME = zstandard.ZstdCompressor().compress(_LAST_WORD)
SUPPORTED = "gzip, zstd"

Sink = Callable[[bytes], object]


class Decoder(Protocol):
    """What stands between the body and the sink."""

    def feed(self, data: bytes) -> None:
        """Decode the next bytes of the body."""
        ...

    def finish(self) -> None:
        """Conclude after the last byte; raise unless the encoded stream is complete."""
        ...


def decoder(content_encoding: str | None, sink: Sink) -> Decoder:
    """Return the decoder for a ``Content-Encoding`` header, which may name one encoding.

    Raises
    ------
    ProblemError
        Of the kind ``unsupported-media-type`` if it is not one that the service decodes.
    """
    given = (name.strip().lower() for name in (content_encoding or "").split(","))
    name = ", ".join(name for name in given if name not in ("", "identity"))
    if not name:
        return _Identity(sink)
    if name in ("gzip", "x-gzip"):
        return _Gzip(sink)
    if name == "zstd":
        return _Zstd(sink)
    detail = f"The content encoding {name[:40]!r} is not supported; send the body as it is, or as gzip or zstd."
    raise ProblemError("unsupported-media-type", detail, {"Accept-Encoding": SUPPORTED})


class _Identity:
    def __init__(self, sink: Sink) -> None:
        self._sink = sink

    def feed(self, data: bytes) -> None:
        self._sink(data)

    def finish(self) -> None:
        pass


class _Gzip:
    """One gzip member or several on end (RFC 1952, section 2.2)."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._members = 0
        self._member = self._next_member()
        self._started = False

    def feed(self, data: bytes) -> None:
        # What follows the end of a member is copied each time one ends: small pieces keep that cheap.
        for start in range(0, len(data), PIECE // 16):
            self._feed(data[start : start + PIECE // 16])

    def finish(self) -> None:
        if self._started:
            raise _damaged("gzip", "it is cut off")

    def _feed(self, data: bytes) -> None:
        self._started = True
        while True:
            try:
                decoded = self._member.decompress(data, PIECE)
            except zlib.error as error:
                raise _damaged("gzip", str(error)) from None
            if decoded:
                self._sink(decoded)
            if self._member.eof:
                data = self._member.unused_data
                self._member = self._next_member()
                self._started = bool(data)
                if not data:
                    return
            elif len(decoded) < PIECE:
                return
            else:  # the piece is full; without a tail there may still be output to come
                data = self._member.unconsumed_tail

    def _next_member(self) -> "zlib._Decompress":
        self._members += 1
        if self._members > _MOST_MEMBERS:
            raise _damaged("gzip", f"it has more than {_MOST_MEMBERS} members")
        return zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)


class _Zstd:
    """One zstd frame or several on end."""

    def __init__(self, sink: Sink) -> None:
        decompressor = zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW)
        self._target = _Writer(sink)
        # Typed as a file, of which nothing but write is called.
        target = cast("IO[bytes]", self._target)
        self._writer = decompressor.stream_writer(target, write_size=PIECE, closefd=False)
        self._waiting = bytearray()

    def feed(self, data: bytes) -> None:
        # zstd is stricter with a frame that it has whole: blocks of a fixed size, so that one body has one verdict.
        self._waiting += data
        while len(self._waiting) >= _BLOCK:
            self._write(bytes(self._waiting[:_BLOCK]))
            del self._waiting[:_BLOCK]

    def finish(self) -> None:
        self._write(bytes(self._waiting))
        # The writer does not tell whether it is inside a frame; a frame of our own is read only where none is open.
        # It is written byte by byte, because zstd reads a frame in one piece even behind a piece of a header.
        found: list[bytes] = []
        self._target.sink = found.append
        with suppress(zstandard.ZstdError):
            for place in range(len(_LAST_FRAME)):
                self._writer.write(_LAST_FRAME[place : place + 1])
        if b"".join(found) != _LAST_WORD:
            raise _damaged("zstd", "it is cut off")

    def _write(self, block: bytes) -> None:
        try:
            self._writer.write(block)
        except zstandard.ZstdError as error:
            raise _damaged("zstd", _reason(error)) from None


class _Writer:
    """A sink as the file-like object that zstandard writes to."""

    def __init__(self, sink: Sink) -> None:
        self.sink = sink

    def write(self, data: bytes) -> int:
        self.sink(data)
        return len(data)


def _reason(error: zstandard.ZstdError) -> str:
    """Say what is wrong with a frame; of what is merely damaged zstd says no more than that, in many words."""
    if "too much memory" in str(error):
        return f"its window is larger than {_LARGEST_WINDOW} bytes, as from levels above 19 or with --long"
    return "it needs a dictionary" if "Dictionary" in str(error) else "it is damaged"


def _damaged(name: str, reason: str) -> ProblemError:
    return ProblemError("bad-encoding", f"The body is not valid {name}: {reason[:200]}.")
