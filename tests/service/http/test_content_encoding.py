"""Decoders of request bodies: what comes in any pieces, and however damaged, is decoded right or refused."""

import asyncio
import gzip

from hypothesis import given
from hypothesis import strategies as st
from starlette.requests import Request
from starlette.types import Message

from dsbrdf_service.errors import ProblemError
from dsbrdf_service.http.messages import PIECE, decoded
from tests.support.strategies import examples

LIMIT = 1 << 20  # what these tests take
# Each part of a body: a few bytes and how often they are repeated.
contents = st.lists(
    st.builds(bytes.__mul__, st.binary(max_size=60), st.one_of(st.integers(0, 5), st.integers(1, 30_000))), max_size=4
)
steps = st.one_of(st.integers(1, 40), st.integers(1, 1 << 21))


def decoded_in_steps(body: bytes, step: int) -> bytes | str:
    """What a body decodes to when it comes in pieces of `step` bytes, or the sentence that refuses it."""
    starts = iter(range(0, len(body) + 1, step))
    parts: list[bytes] = []

    async def receive() -> Message:
        start = next(starts)
        return {"type": "http.request", "body": body[start : start + step], "more_body": start + step <= len(body)}

    async def decode() -> None:
        scope = {"type": "http", "headers": [(b"content-encoding", b"gzip")]}
        async for part in decoded(Request(scope, receive), 100 * LIMIT):
            assert len(part) <= PIECE
            parts.append(part)
            if sum(map(len, parts)) > LIMIT:  # no more is decoded than the first piece that is too much
                raise ProblemError("too-large", "The body is too long.")

    try:
        asyncio.run(decode())
    except ProblemError as error:
        return error.detail
    return b"".join(parts)


@examples(1)
@given(parts=contents, step=steps)
def test_body_decodes_or_exceeds_the_limit(parts: list[bytes], step: int) -> None:
    whole = b"".join(parts)
    body = gzip.compress(whole, 1)
    expected = "The body is too long." if len(whole) > LIMIT else whole
    assert decoded_in_steps(body, max(step, len(body) // 2000)) == expected


@examples(3)
@given(content=st.binary(max_size=400), cut=st.floats(0, 1, exclude_max=True), more=st.binary(min_size=1), step=steps)
def test_body_that_is_cut_off_or_goes_on_is_refused(content: bytes, cut: float, more: bytes, step: int) -> None:
    body = gzip.compress(content)
    for wrong in (body[: int(cut * len(body))], body + more):
        assert "is not valid" in str(decoded_in_steps(wrong, step))


@examples(5)
@given(
    parts=contents,
    changes=st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=6)), min_size=1, max_size=4),
    step=steps,
)
def test_damaged_body_gets_one_result_in_any_chunks(
    parts: list[bytes], changes: list[tuple[float, bytes]], step: int
) -> None:
    body = bytearray(gzip.compress(b"".join(parts), 1))
    for place, content in changes:
        start = int(place * len(body))
        body[start : start + len(content)] = content
    whole = decoded_in_steps(bytes(body), len(body) + 1)
    assert decoded_in_steps(bytes(body), max(step, len(body) // 2000)) == whole
    if isinstance(whole, bytes):
        assert whole == gzip.decompress(bytes(body))
