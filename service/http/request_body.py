"""Request bodies: measurements that are hashed while they are written, and small ones kept whole."""

import asyncio
import mmap
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial
from typing import ParamSpec, TypeVar, cast

from anyio import CapacityLimiter, to_thread
from starlette.requests import Request

from dsbrdf import MeasurementFormatError
from dsbrdf.data.merl import FILE_SIZE, MerlChecker, check_header, check_length
from dsbrdf.data.merl_validation import HEADER_SIZE
from service.access.authentication import caller_of, over_quota
from service.http.content_encoding import decoder
from service.http.problems import ProblemError
from service.storage.blobs import Incoming
from service.storage.quota import StorageQuotaError
from service.storage.rows import MeasurementRow
from service.storage.store import Store

P = ParamSpec("P")
S = TypeVar("S")
T = TypeVar("T")

_PIECE = 1 << 16  # bytes that are worth a switch to another thread, and small enough for many uploads at once
# Few threads for all uploads: each that has ever worked keeps memory for its next piece.
_threads = CapacityLimiter(4)
# Compressors add less than this to what they cannot compress.
_LARGEST_ENCODED = FILE_SIZE + FILE_SIZE // 64


async def receive_measurement(request: Request, store: Store) -> tuple[MeasurementRow, bool]:
    """Store the MERL file that is the body of `request`; the flag says whether it is new.

    The body is never held whole, and nothing of it stays if anything is wrong with it.

    Raises
    ------
    MeasurementFormatError
        If it is not an acceptable measurement.
    ProblemError
        If it is too long, or its encoding is unknown or damaged.
    """
    encoding = _encoding(request)
    declared = request.headers.get("content-length", "")
    if not encoding and declared.isdecimal() and int(declared) != FILE_SIZE:
        await _refuse(request, int(declared))
    caller = caller_of(request)
    try:
        incoming = await _in_thread(store.begin_upload, caller)
    except StorageQuotaError as error:
        raise over_quota(error) from None
    try:
        receiver = _Receiver(incoming, encoding)
        await _take_all(request, receiver)
        await _in_thread(receiver.finish)
        # The disk and the processor have work of their own here, and neither waits for the other.
        valid_nodes, sha256 = await _both(_in_thread(receiver.check), _in_thread(incoming.close))
        return await _in_thread(store.add_measurement, caller, incoming, sha256, valid_nodes)
    except StorageQuotaError as error:
        raise over_quota(error) from None
    finally:
        await asyncio.shield(_in_thread(store.end_upload, caller, incoming))


async def receive_small(request: Request, limit: int) -> memoryview:
    """Return the decoded body of `request`, of at most `limit` bytes.

    Its memory is reserved at once, used as it fills and given back as one: a buffer that grows is there twice while it
    is moved, and leaves holes.

    Raises
    ------
    ProblemError
        If it is longer, or its encoding is unknown or damaged.
    """
    too_large = ProblemError("too-large", f"The body is longer than the {limit} bytes that it may have here.")
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


async def _take_all(request: Request, receiver: "_Receiver") -> None:
    """Let the receiver take the body, each piece while the next one arrives."""
    taking: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    taking.set_result(None)
    try:
        async for piece in _pieces(request):
            await taking
            taking = asyncio.ensure_future(_in_thread(receiver.take, piece))
            if not _threads.available_tokens:  # other uploads use them all: a piece ahead is memory for nothing
                await taking
        await taking
    finally:
        await asyncio.gather(taking, return_exceptions=True)


async def _both(one: Awaitable[S], other: Awaitable[T]) -> tuple[S, T]:
    """Return what both return, or raise what one raises, when both have ended."""
    first, second = await asyncio.gather(one, other, return_exceptions=True)
    for outcome in (first, second):
        if isinstance(outcome, BaseException):
            raise outcome
    return cast("S", first), cast("T", second)


def _encoding(request: Request) -> str:
    return ", ".join(request.headers.getlist("content-encoding"))


async def _in_thread(call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    return await to_thread.run_sync(partial(call, *args, **kwargs), limiter=_threads)


class _Receiver:
    """Takes the pieces of a body, in a worker thread, and writes what they decode to.

    Header and length are checked as they arrive; the values when all are there, from the file, since a check takes
    memory that many uploads at once should not have at the same time.
    """

    def __init__(self, incoming: Incoming, encoding: str) -> None:
        self._incoming = incoming
        self._header = b""
        self._decoder = decoder(encoding, self._write)
        self._encoded = 0

    def take(self, piece: bytes) -> None:
        self._encoded += len(piece)
        if self._encoded > _LARGEST_ENCODED:
            detail = f"The body is longer than {_LARGEST_ENCODED} bytes, more than an encoded measurement takes."
            raise ProblemError("too-large", detail)
        self._decoder.feed(piece)

    def finish(self) -> None:
        self._decoder.finish()

    def check(self) -> int:
        checker = MerlChecker()
        for piece in self._incoming.pieces(4 * _PIECE):
            checker.update(piece)
        return int(checker.finish().sum())

    def _write(self, data: bytes) -> None:
        if len(self._header) < HEADER_SIZE:
            self._header += data[: HEADER_SIZE - len(self._header)]
            if len(self._header) == HEADER_SIZE:
                check_header(self._header)
        n_bytes = self._incoming.size + len(data)
        if n_bytes > FILE_SIZE:
            _refuse_length(n_bytes)
        self._incoming.write(data)


async def _pieces(request: Request) -> AsyncIterator[bytes]:
    """Yield the body in pieces that are worth a switch to another thread."""
    parts: list[bytes] = []
    size = 0
    async for part in request.stream():
        parts.append(part)
        size += len(part)
        if size >= _PIECE:
            piece = part if size == len(part) else b"".join(parts)
            parts.clear()
            size = 0
            yield piece
    if size:
        yield b"".join(parts)


async def _refuse(request: Request, length: int) -> None:
    """Refuse a body of a wrong length by its first bytes, with the sentence that the whole would get."""
    start = b""
    async for part in request.stream():
        start += part
        if len(start) >= HEADER_SIZE:
            check_header(start)
            break
    _refuse_length(length)


def _refuse_length(n_bytes: int) -> None:
    """Refuse a file that does not have the length of a measurement."""
    try:
        check_length(n_bytes)
    except MeasurementFormatError as error:
        if n_bytes > FILE_SIZE:
            raise ProblemError("measurement-too-large", str(error)) from None
        raise
