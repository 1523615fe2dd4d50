"""Responses with a model's values, as JSON or .npy: a few at once, many block by block, so that memory stays small."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from io import BytesIO
from json import JSONEncoder
from time import perf_counter

from numpy.lib import format as npy
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse

from dsbrdf import DSBRDF
from service.operations.metrics import Metrics
from service.wire.points import NPY, Points

JSON = "application/json"

_MAX_INLINE = 64  # points that are evaluated faster than another thread is reached
_JSON_BLOCK = 4096  # points; text is made in one go, during which nothing else runs
_NPY_BLOCK = 131_072  # points that a model evaluates at a time
_AHEAD = 2  # blocks that are computed at the same time, while those before them are sent
_encode = JSONEncoder(allow_nan=False, separators=(",", ":")).encode


@dataclass(frozen=True)
class _JsonForm:
    """JSON text; its blocks are joined by commas."""

    media_type = JSON
    block = _JSON_BLOCK
    head, between, tail = b'{"values":[', b",", b"]}"

    def write(self, model: DSBRDF, points: Points) -> bytes:
        return _encode(points.values(model).tolist())[1:-1].encode()


@dataclass(frozen=True)
class _NpyForm:
    """A .npy file of shape (n, 3)."""

    n_points: int
    media_type = NPY
    block = _NPY_BLOCK
    between, tail = b"", b""

    @property
    def head(self) -> bytes:
        buffer = BytesIO()
        npy.write_array_header_1_0(buffer, {"descr": "<f8", "fortran_order": False, "shape": (self.n_points, 3)})
        return buffer.getvalue()

    def write(self, model: DSBRDF, points: Points) -> bytes:
        return points.values(model).tobytes()


_Form = _JsonForm | _NpyForm


async def values_reply(model: DSBRDF, points: Points, media_type: str, metrics: Metrics) -> Response:
    """Return the values of a model at some points, as JSON or as a .npy array of shape (n, 3) [1/sr]."""
    form: _Form = _NpyForm(len(points)) if media_type == NPY else _JsonForm()

    def whole() -> Response:
        with metrics.timing("evaluating"):
            return Response(form.head + form.write(model, points) + form.tail, media_type=media_type)

    if len(points) <= _MAX_INLINE:
        return whole()
    if len(points) <= form.block:
        return await run_in_threadpool(whole)
    # The length is known beforehand for numbers of equal size, not for their text.
    headers = {"Content-Length": str(len(form.head) + 24 * len(points))} if isinstance(form, _NpyForm) else None
    return StreamingResponse(_parts(form, model, points, metrics), headers=headers, media_type=media_type)


async def _parts(form: _Form, model: DSBRDF, points: Points, metrics: Metrics) -> AsyncIterator[bytes]:
    """Yield the parts of a long answer, each while the next ones are made; note how long that took in all."""
    seconds = 0.0

    def write(block: Points) -> bytes:
        nonlocal seconds
        begin = perf_counter()
        part = form.write(model, block)
        seconds += perf_counter() - begin
        return part

    blocks: Iterator[Points] = points.blocks(form.block)
    coming: deque[asyncio.Task[bytes]] = deque()

    def begin_next() -> None:
        if (block := next(blocks, None)) is not None:
            coming.append(asyncio.create_task(run_in_threadpool(write, block)))

    try:
        for _ in range(_AHEAD):
            begin_next()
        before = form.head
        while coming:
            part = await coming[0]
            coming.popleft()
            begin_next()
            yield before + part
            before = form.between
        yield form.tail
    finally:
        for task in coming:  # of a client that has gone
            task.cancel()
    metrics.took("evaluating", seconds)
