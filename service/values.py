"""Answers with a model's values, as JSON or .npy: a few at once, many block by block, so that none is held for long."""

from collections.abc import Iterator
from io import BytesIO
from json import JSONEncoder
from time import perf_counter

from numpy.lib import format as npy
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse

from dsbrdf import DSBRDF
from service.metrics import Metrics
from service.points import NPY, Points

JSON = "application/json"

_INLINE = 64  # points that are evaluated faster than another thread is reached
_JSON_BLOCK = 4096  # points; text is made in one go, during which nothing else runs
_NPY_BLOCK = 131_072  # points that a model evaluates at a time
_encode = JSONEncoder(allow_nan=False, separators=(",", ":")).encode


async def values_reply(model: DSBRDF, points: Points, media_type: str, metrics: Metrics) -> Response:
    """Return the values of a model at some points, as JSON or as a .npy array of shape (n, 3) [1/sr]."""
    parts, block = (_npy_parts, _NPY_BLOCK) if media_type == NPY else (_json_parts, _JSON_BLOCK)

    def whole() -> Response:
        with metrics.timing("evaluating"):
            return Response(b"".join(parts(model, points)), media_type=media_type)

    if len(points) <= _INLINE:
        return whole()
    if len(points) <= block:
        return await run_in_threadpool(whole)
    # The length is known beforehand for numbers of equal size, not for their text.
    headers = {"Content-Length": str(len(_npy_head(points)) + 24 * len(points))} if media_type == NPY else None
    return StreamingResponse(_timed(parts(model, points), metrics), headers=headers, media_type=media_type)


def _json_parts(model: DSBRDF, points: Points) -> Iterator[bytes]:
    between = '{"values":['
    for block in points.blocks(_JSON_BLOCK):
        yield (between + _encode(block.values(model).tolist())[1:-1]).encode()
        between = ","
    yield b"]}"


def _npy_parts(model: DSBRDF, points: Points) -> Iterator[bytes]:
    yield _npy_head(points)
    for block in points.blocks(_NPY_BLOCK):
        yield block.values(model).tobytes()


def _npy_head(points: Points) -> bytes:
    buffer = BytesIO()
    npy.write_array_header_1_0(buffer, {"descr": "<f8", "fortran_order": False, "shape": (len(points), 3)})
    return buffer.getvalue()


def _timed(parts: Iterator[bytes], metrics: Metrics) -> Iterator[bytes]:
    """Pass the parts on; note how long they took to make, without the time to send them."""
    seconds = 0.0
    while True:
        begin = perf_counter()
        part = next(parts, None)
        seconds += perf_counter() - begin
        if part is None:
            break
        yield part
    metrics.took("evaluating", seconds)
