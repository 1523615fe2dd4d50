"""Request bodies: measurements that are hashed while they are written, small ones kept whole, and their encodings.

A decoder is given the body in pieces and passes decoded pieces of at most `PIECE` bytes to a sink, which raises as
soon as it has enough: a small body that decodes to a huge one costs no more memory or time than the limit.
"""

import asyncio
import mmap
import zlib
from collections.abc import AsyncIterator, Callable
from functools import partial
from typing import Any, ParamSpec, TypeVar

from anyio import CapacityLimiter, to_thread
from backports import zstd
from starlette.requests import Request

from dsbrdf.data.merl_validation import FILE_SIZE, HEADER_SIZE, MerlChecker, check_header, check_length
from dsbrdf.errors import MeasurementFormatError
from service.errors import (
    BadEncodingError,
    MeasurementTooLargeError,
    ProblemError,
    TooLargeError,
    UnsupportedMediaTypeError,
)
from service.storage.blobs import Incoming
from service.storage.schema import Caller, MeasurementRow
from service.storage.store import Store

P = ParamSpec("P")
T = TypeVar("T")
Sink = Callable[[bytes], object]

PIECE = 1 << 18
SUPPORTED_ENCODINGS = "gzip, zstd"
_BLOCK = 1 << 14  # encoded bytes that are decoded at a time, so that a body has one verdict however it arrives
_MAX_MEMBERS = 10_000
_ZSTD_WINDOW_LOG = 23  # 8 MiB, what RFC 9659 asks every decoder of zstd content to support
_RECEIVED_PIECE = 1 << 16  # bytes that are worth a switch to another thread, and small enough for many uploads at once
# Few threads for all uploads: each that has ever worked keeps memory for its next piece.
_threads = CapacityLimiter(4)
# Compressors add less than this to what they cannot compress.
_MAX_ENCODED = FILE_SIZE + FILE_SIZE // 64


async def receive_measurement(request: Request, caller: Caller, store: Store) -> tuple[MeasurementRow, bool]:
    """Store the MERL file that is the body of `request`; the flag says whether it is new to the caller.

    The body is never held whole, and nothing of it stays if anything is wrong with it.

    Raises MeasurementFormatError if it is not an acceptable measurement. Raises ProblemError if it is too long, its
    encoding is unknown or damaged, or the caller may not store it.
    """
    encoding = _encoding(request)
    declared = request.headers.get("content-length", "")
    if not encoding and declared.isdecimal() and int(declared) != FILE_SIZE:
        await _refuse_early(request, int(declared))
    incoming = await _in_thread(store.begin_upload, caller)
    try:
        receiver = _Receiver(incoming, encoding)
        await _receive_all(request, receiver)
        await _in_thread(receiver.finish)
        # The disk and the processor have work of their own here, and neither waits for the other.
        closing = asyncio.ensure_future(_in_thread(incoming.close))
        try:
            valid_nodes = await _in_thread(receiver.check)
        finally:
            sha256 = await closing
        return await _in_thread(store.add_measurement, caller, incoming, sha256, valid_nodes)
    finally:
        await asyncio.shield(_in_thread(store.end_upload, caller, incoming))


async def receive_small(request: Request, limit: int) -> memoryview:
    """Return the decoded body of `request`, of at most `limit` bytes.

    Its memory is reserved at once, used as it fills and given back as one: a buffer that grows is there twice while it
    is moved, and leaves holes.

    Raises ProblemError if it is longer, or its encoding is unknown or damaged.
    """
    too_large = TooLargeError(f"The body is longer than the {limit} bytes that it may have here.")
    body = memoryview(mmap.mmap(-1, limit))
    size = 0

    def keep(data: bytes) -> None:
        nonlocal size
        if size + len(data) > limit:
            raise too_large
        body[size : size + len(data)] = data
        size += len(data)

    encoded = decoder(_encoding(request), keep)
    declared = request.headers.get("content-length", "")
    if declared.isdecimal() and int(declared) > limit:
        raise too_large
    n_encoded = 0
    async for piece in request.stream():
        n_encoded += len(piece)
        if n_encoded > limit + limit // 64 + 1024:  # compressors add less; what decodes to nothing can be endless
            raise too_large
        encoded.feed(piece)
    encoded.finish()
    return body[:size]


def decoder(content_encoding: str, sink: Sink) -> "_Identity | _MemberDecoder":
    """Return the decoder for a ``Content-Encoding`` header, which may name one encoding.

    Raises UnsupportedMediaTypeError if it is not one that the service decodes.
    """
    given = (name.strip().lower() for name in content_encoding.split(","))
    name = ", ".join(name for name in given if name not in ("", "identity"))
    if not name:
        return _Identity(sink)
    if name in ("gzip", "x-gzip"):
        return _MemberDecoder("gzip", partial(zlib.decompressobj, wbits=16 + zlib.MAX_WBITS), sink)
    if name == "zstd":
        options = {int(zstd.DecompressionParameter.window_log_max): _ZSTD_WINDOW_LOG}
        return _MemberDecoder("zstd", partial(zstd.ZstdDecompressor, options=options), sink)
    detail = f"The content encoding {name[:40]!r} is not supported; send the body as it is, or as gzip or zstd."
    raise UnsupportedMediaTypeError(detail, {"Accept-Encoding": SUPPORTED_ENCODINGS})


class _Identity:
    """A body without encoding."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink

    def feed(self, data: bytes) -> None:
        self._sink(data)

    def finish(self) -> None:
        """Do nothing: every end is a complete one."""


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
                self._begin_member()
                if not data:
                    return
            elif len(decoded) < PIECE:
                return
            else:  # there may be more output; zstd keeps the rest of the input itself
                data = getattr(self._member, "unconsumed_tail", b"")

    def _begin_member(self) -> None:
        self._n_members += 1
        if self._n_members > _MAX_MEMBERS:
            raise self._damaged(f"it has more than {_MAX_MEMBERS} members")
        self._member = self._new_member()

    def _damaged(self, reason: str) -> ProblemError:
        return BadEncodingError(f"The body is not valid {self._name}: {reason[:200]}.")


def _reason(error: Exception) -> str:
    """Return what is wrong with a member; of a damaged frame zstd says no more than that, in many words."""
    if isinstance(error, zlib.error):
        return str(error)
    if "too much memory" in str(error):
        return f"its window is larger than {1 << _ZSTD_WINDOW_LOG} bytes, as from levels above 19 or with --long"
    return "it needs a dictionary" if "ictionary" in str(error) else "it is damaged"


class _Receiver:
    """Takes the pieces of a body, in a worker thread, and writes what they decode to.

    Header and length are checked as they arrive; the values when all are there, from the file, since a check takes
    memory that many uploads at once should not have at the same time.
    """

    def __init__(self, incoming: Incoming, encoding: str) -> None:
        self._incoming = incoming
        self._header = b""
        self._decoder = decoder(encoding, self._write)
        self._n_encoded = 0

    def feed(self, piece: bytes) -> None:
        self._n_encoded += len(piece)
        if self._n_encoded > _MAX_ENCODED:
            raise TooLargeError(
                f"The body is longer than {_MAX_ENCODED} bytes, more than an encoded measurement takes."
            )
        self._decoder.feed(piece)

    def finish(self) -> None:
        self._decoder.finish()

    def check(self) -> int:
        """Check the values and return the number of valid nodes."""
        checker = MerlChecker()
        for piece in self._incoming.pieces(4 * _RECEIVED_PIECE):
            checker.update(piece)
        return int(checker.finish().sum())

    def _write(self, data: bytes) -> None:
        if len(self._header) < HEADER_SIZE:
            self._header += data[: HEADER_SIZE - len(self._header)]
            if len(self._header) == HEADER_SIZE:
                check_header(self._header)
        _check_not_longer(self._incoming.size + len(data))
        self._incoming.write(data)


async def _receive_all(request: Request, receiver: _Receiver) -> None:
    """Pass the body to the receiver, each piece while the next one arrives."""
    feeding: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    feeding.set_result(None)
    try:
        async for piece in _pieces(request):
            await feeding
            feeding = asyncio.ensure_future(_in_thread(receiver.feed, piece))
            if not _threads.available_tokens:  # other uploads use them all: a piece ahead is memory for nothing
                await feeding
        await feeding
    finally:
        await asyncio.gather(feeding, return_exceptions=True)


async def _pieces(request: Request) -> AsyncIterator[bytes]:
    """Yield the body in pieces that are worth a switch to another thread."""
    parts: list[bytes] = []
    size = 0
    async for part in request.stream():
        parts.append(part)
        size += len(part)
        if size >= _RECEIVED_PIECE:
            piece = part if size == len(part) else b"".join(parts)
            parts.clear()
            size = 0
            yield piece
    if size:
        yield b"".join(parts)


async def _refuse_early(request: Request, length: int) -> None:
    """Refuse a body of a wrong length by its first bytes, with the sentence that the whole would get."""
    start = b""
    async for part in request.stream():
        start += part
        if len(start) >= HEADER_SIZE:
            check_header(start)
            break
    _check_not_longer(length)
    check_length(length)


def _check_not_longer(n_bytes: int) -> None:
    """Check that a file is not longer than a measurement."""
    if n_bytes > FILE_SIZE:
        try:
            check_length(n_bytes)
        except MeasurementFormatError as error:  # the library's sentence, with a kind of its own
            raise MeasurementTooLargeError(str(error)) from None


def _encoding(request: Request) -> str:
    return ", ".join(request.headers.getlist("content-encoding"))


async def _in_thread(call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    return await to_thread.run_sync(partial(call, *args, **kwargs), limiter=_threads)
