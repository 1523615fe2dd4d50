"""Uploads: measurements that are hashed and checked while they are written, and how much an API key may have.

A body is never held whole, and nothing of it stays if anything is wrong with it.
"""

import asyncio
import sqlite3
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, ParamSpec, Protocol, TypeVar

from anyio import CapacityLimiter, to_thread

from dsbrdf.data.merl_validation import FILE_SIZE, HEADER_SIZE, MerlChecker, check_header, check_length
from dsbrdf.errors import MeasurementFormatError

from ..errors import ProblemError
from .blobs import Blobs, Incoming
from .conversions import Converted
from .database import Database
from .schema import IS_UNFINISHED, Caller

P = ParamSpec("P")
T = TypeVar("T")
Sink = Callable[[bytes], None]

_PIECE = 1 << 19  # bytes that are worth a switch to another thread
_SMALL_PIECE = 1 << 16  # of many uploads at once
_BLOCK = 1 << 18  # bytes that are read back from the file at a time
_CHECKED_AT_ONCE = 8  # uploads that are checked while they arrive
# Few threads for all uploads, because each keeps the memory of its last piece.
_threads = CapacityLimiter(4)
# Compressors add less than this to what they cannot compress.
_MAX_ENCODED = FILE_SIZE + FILE_SIZE // 64
_MAX_CONVERTED = 1 << 23  # bytes of an RGL file or a table: to read one takes up to 70 times as much memory
_STORED = (
    "SELECT (SELECT coalesce(sum(size), 0) FROM measurements WHERE owner = ?)"
    " + (SELECT coalesce(sum(size), 0) FROM fits WHERE owner = ?)"
)
_REMEDY = "delete what is not needed any more."


class Decoder(Protocol):
    """Passes what a body decodes to on to a sink."""

    def feed(self, data: bytes) -> None:
        """Decode the next bytes."""

    def finish(self) -> None:
        """Check that the body is complete."""


@dataclass(frozen=True)
class UploadBody:
    """What a client sends: `parts` as they arrive, the `length` that the file will have if it is known, a decoder."""

    parts: AsyncIterator[bytes]
    length: int | None
    decoder: Callable[[Sink], Decoder]


Convert = Callable[[Path], Awaitable[Converted]]
"""Checks a file that is no MERL file, and replaces its content by what is stored of it."""


class Received(NamedTuple):
    """A measurement that is complete and right, in a file that is not in its place yet."""

    incoming: Incoming
    sha256: str
    valid_nodes: int


class Uploads:
    """The uploads in progress, counted by owner: what they write takes room before it is stored."""

    def __init__(self, database: Database, blobs: Blobs) -> None:
        self._database = database
        self._blobs = blobs
        self._in_progress: Counter[str] = Counter()  # changed by the event loop alone

    @asynccontextmanager
    async def receive(self, caller: Caller, body: UploadBody, convert: Convert | None) -> AsyncIterator[Received]:
        """Receive and check the MERL file that is the body; yield it to be stored, without which nothing of it stays.

        What is no MERL file is given to `convert` when it is complete.

        Raises MeasurementFormatError if it is not an acceptable measurement. Raises ProblemError if it is too long, it
        does not decode, or the caller may not store it.
        """
        if convert is not None:
            _check_convertible(body.length or 0)
        elif body.length not in (None, FILE_SIZE):
            await _refuse_early(body.parts, body.length or 0)
        async with self.incoming(caller) as incoming:
            at_once = self._in_progress.total() <= _CHECKED_AT_ONCE
            if convert is None:
                valid_nodes = await _write_merl(body, incoming, at_once=at_once)
                yield Received(incoming, await in_thread(incoming.close), valid_nodes)
            else:
                await _write_any(body, incoming, at_once=at_once)
                await in_thread(incoming.close)
                sha256, incoming.size, valid_nodes = await convert(incoming.path)
                yield Received(incoming, sha256, valid_nodes)

    @asynccontextmanager
    async def incoming(self, caller: Caller) -> AsyncIterator[Incoming]:
        """Yield a new file, which is removed afterwards unless it was stored; the upload counts as long as that takes.

        One upload at a time is let in for a caller that has no room left: its file may be one that is stored already.

        Raises ProblemError if those in progress take all the room that the caller has left.
        """
        others = self._in_progress[caller.owner]
        self._in_progress[caller.owner] += 1
        try:
            await in_thread(self._check_room, caller, others)
            incoming = await in_thread(self._blobs.incoming)
            try:
                yield incoming
            finally:
                await asyncio.shield(in_thread(incoming.discard))
        finally:
            self._in_progress[caller.owner] -= 1
            self._in_progress += Counter()  # without those that have none

    def _check_room(self, caller: Caller, in_progress: int) -> None:
        if caller.stored_bytes is None:
            return
        ((stored,),) = self._database.rows(_STORED, caller.owner, caller.owner)
        if in_progress >= max(1, (caller.stored_bytes - stored) // FILE_SIZE):
            uploads = f"{in_progress} upload{'s' if in_progress > 1 else ''} in progress"
            detail = f"{_usage(caller, stored)} and {uploads}, which take the rest; {_REMEDY}"
            raise ProblemError("storage-quota", detail)


async def in_thread(call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Call what belongs to an upload in one of the few threads for all of them."""
    return await to_thread.run_sync(lambda: call(*args, **kwargs), limiter=_threads)


async def _write_merl(body: UploadBody, incoming: Incoming, *, at_once: bool) -> int:
    """Write the MERL file that the body decodes to; return the number of valid nodes.

    Its values are checked `at_once` or at the end: a check takes memory that many uploads should not have together.
    """
    header = b""
    checker = MerlChecker() if at_once else None

    def write(data: bytes) -> None:
        nonlocal header
        if len(header) < HEADER_SIZE:
            header += data[: HEADER_SIZE - len(header)]
            if len(header) == HEADER_SIZE:
                check_header(header)
        _check_not_longer(incoming.size + len(data))
        incoming.write(data)
        if checker is not None:
            checker.update(data)

    def finish() -> int:
        """Check the whole, read back unless it has been checked already; return the number of valid nodes."""
        complete = checker or MerlChecker()
        while block := incoming.read(complete.n_bytes, _BLOCK):
            complete.update(block)
        return int(complete.finish().sum())

    await _write(body, write, at_once=at_once)
    return await in_thread(finish)


async def _write_any(body: UploadBody, incoming: Incoming, *, at_once: bool) -> None:
    """Write what the body decodes to, of which nothing is known but its largest length."""

    def write(data: bytes) -> None:
        _check_convertible(incoming.size + len(data))
        incoming.write(data)

    await _write(body, write, at_once=at_once)


async def _write(body: UploadBody, write: Sink, *, at_once: bool) -> None:
    """Write what the body decodes to, each piece while the next one arrives."""
    n_received = 0
    decoder = body.decoder(write)
    writing: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    writing.set_result(None)
    try:
        async for piece in _pieces(body.parts, _PIECE if at_once else _SMALL_PIECE):
            await writing
            n_received += len(piece)
            if n_received > _MAX_ENCODED:
                most = f"The body is longer than {_MAX_ENCODED} bytes, more than an encoded measurement takes."
                raise ProblemError("too-large", most)
            writing = asyncio.ensure_future(in_thread(decoder.feed, piece))
            if not _threads.available_tokens:  # all are busy: reading ahead would only take memory
                await writing
        await writing
        await in_thread(decoder.finish)
    finally:
        await asyncio.gather(writing, return_exceptions=True)


async def _pieces(parts: AsyncIterator[bytes], least: int) -> AsyncIterator[bytes]:
    """Yield the header at once, as it may be wrong; the rest in pieces that are worth a switch to another thread."""
    waiting: list[bytes] = []
    size, enough = 0, HEADER_SIZE
    async for part in parts:
        waiting.append(part)
        size += len(part)
        if size >= enough:
            piece = part if size == len(part) else b"".join(waiting)
            waiting.clear()
            size, enough = 0, least
            yield piece
    if size:
        yield b"".join(waiting)


async def _refuse_early(parts: AsyncIterator[bytes], length: int) -> None:
    """Refuse a body of a wrong length by its first bytes, with the sentence that the whole would get."""
    start = b""
    async for part in parts:
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
            raise ProblemError("measurement-too-large", str(error)) from None


def _check_convertible(n_bytes: int) -> None:
    """Check the length of a file that is no MERL file."""
    if n_bytes > _MAX_CONVERTED:
        most = f"A .bsdf file or a table has at most {_MAX_CONVERTED} bytes here, and this one is longer."
        raise ProblemError("measurement-too-large", most)


def check_queue(db: sqlite3.Connection, caller: Caller) -> None:
    """Raise ProblemError if the caller has as many unfinished fits as it may have."""
    if caller.queued_fits is None:
        return
    query = f"SELECT count(*) FROM fits WHERE owner = ? AND {IS_UNFINISHED}"  # noqa: S608
    (unfinished,) = db.execute(query, (caller.owner,)).fetchone()
    if unfinished >= caller.queued_fits:
        raise ProblemError(
            "queue-quota",
            f"{unfinished} fits of this key are unfinished, the most allowed; ask again when one has ended.",
        )


def check_storage(db: sqlite3.Connection, caller: Caller, more: int) -> None:
    """Raise ProblemError if the caller has no room for `more` bytes, or for one at least."""
    if caller.stored_bytes is None:
        return
    (stored,) = db.execute(_STORED, (caller.owner, caller.owner)).fetchone()
    if stored + max(more, 1) > caller.stored_bytes:
        measurement = f" and the measurement has {more / 1e6:.1f} MB" if more else ""
        raise ProblemError("storage-quota", f"{_usage(caller, stored)}{measurement}; {_REMEDY}")


def _usage(caller: Caller, stored: int) -> str:
    return f"this key has stored {stored / 1e6:.1f} of {(caller.stored_bytes or 0) / 1e6:.1f} MB"
