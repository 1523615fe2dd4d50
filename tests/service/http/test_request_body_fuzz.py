"""Bodies and queries from strangers: decoders, .npy files and points, in any pieces and however damaged."""

import gzip
import struct
import zlib

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from service.errors import ProblemError
from service.http.request_body import PIECE, decoder
from tests.support.strategies import examples

LIMIT = 1 << 20  # what the sinks of these tests take


class Sink:
    """Takes so many bytes and no more, as those of the service do."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.seen = 0

    def __call__(self, data: bytes) -> None:
        self.seen += len(data)
        if self.seen > LIMIT:
            raise ProblemError("too-large", "The body is too long.")
        self.parts.append(data)


def decoded(encoding: str, body: bytes, step: int) -> bytes | str:
    """What a body decodes to when it comes in pieces of `step` bytes, or the sentence that refuses it."""
    sink = Sink()
    try:
        stage = decoder(encoding, sink)
        for start in range(0, len(body), step):
            stage.feed(body[start : start + step])
        stage.finish()
    except ProblemError as error:
        return error.detail
    finally:
        # No more is decoded than the first piece that is too much.
        assert sink.seen <= LIMIT + PIECE
    return b"".join(sink.parts)


def zstd(content: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=1, write_checksum=True).compress(content)


COMPRESS = {"gzip": lambda content: gzip.compress(content, 1), "zstd": zstd}

SKIPPABLE = struct.pack("<II", 0x184D2A50, 3) + b"abc"


def members(encoding: str, parts: list[tuple[bytes, int]]) -> list[tuple[bytes, bytes]]:
    """The contents that the parts stand for, each with its compressed form."""
    return [(content * count, COMPRESS[encoding](content * count)) for content, count in parts]


encodings = st.sampled_from(["gzip", "zstd"])


# Each part of a body: a few bytes and how often they are repeated.
contents = st.lists(st.tuples(st.binary(max_size=60), st.one_of(st.integers(0, 5), st.integers(1, 30_000))), max_size=4)

steps = st.one_of(st.integers(1, 40), st.integers(1, 1 << 21))


@examples(1)
@given(encoding=encodings, parts=contents, step=steps, skipped=st.booleans())
def test_concatenated_members_decode_or_exceed_the_limit(
    encoding: str, parts: list[tuple[bytes, int]], step: int, skipped: bool
) -> None:
    whole = b"".join(repeated for repeated, _ in members(encoding, parts))
    body = b"".join(packed for _, packed in members(encoding, parts))
    if skipped and encoding == "zstd":
        body = SKIPPABLE + body + SKIPPABLE
    expected = "The body is too long." if len(whole) > LIMIT else whole
    assert decoded(encoding, body, max(step, len(body) // 2000)) == expected


@examples(3)
@given(
    encoding=encodings, content=st.binary(max_size=400), cut=st.floats(0, 1, exclude_max=True), step=st.integers(1, 500)
)
def test_truncated_body_is_refused(encoding: str, content: bytes, cut: float, step: int) -> None:
    body = COMPRESS[encoding](content)
    first = COMPRESS[encoding](b"first")
    for start, whole in ((b"", b""), (first, b"first")):
        part = body[: int(cut * len(body))]
        answer = decoded(encoding, start + part, step)
        assert answer == whole if not part else "is not valid" in str(answer)


def test_zstd_frame_with_wrong_length_gets_one_result_in_any_chunks() -> None:
    body = bytearray(zstd(b""))
    body[5] = 1  # the length of the content, which zstd compares only for a frame that it has whole
    whole = decoded("zstd", bytes(body), len(body))
    assert {decoded("zstd", bytes(body), step) for step in range(1, len(body))} == {whole}


@examples(3)
@given(
    encoding=encodings,
    content=st.binary(max_size=100),
    garbage=st.binary(min_size=1, max_size=40),
    step=st.integers(1, 500),
)
def test_garbage_after_a_member_is_refused(encoding: str, content: bytes, garbage: bytes, step: int) -> None:
    body = COMPRESS[encoding](content) + b"\0" + garbage
    assert "is not valid" in str(decoded(encoding, body, step))


@examples(5)
@given(
    encoding=encodings,
    parts=contents,
    changes=st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=6)), min_size=1, max_size=4),
    step=steps,
)
def test_damaged_body_gets_one_result_in_any_chunks(
    encoding: str, parts: list[tuple[bytes, int]], changes: list[tuple[float, bytes]], step: int
) -> None:
    body = bytearray(b"".join(packed for _, packed in members(encoding, parts)))
    for place, content in changes:
        start = int(place * len(body))
        body[start : start + len(content)] = content
    whole = decoded(encoding, bytes(body), len(body) + 1)
    assert decoded(encoding, bytes(body), max(step, len(body) // 2000)) == whole
    if encoding == "gzip" and isinstance(whole, bytes):
        assert whole == (gzip.decompress(bytes(body)) if body else b"")


@examples(2)
@given(noise=st.binary(max_size=300), step=st.integers(1, 300))
def test_random_bytes_get_one_result_in_any_chunks(noise: bytes, step: int) -> None:
    for encoding, magic in (("gzip", b"\x1f\x8b\x08\0\0\0\0\0\0\0"), ("zstd", b"\x28\xb5\x2f\xfd")):
        for body in (noise, magic + noise):
            assert decoded(encoding, body, step) == decoded(encoding, body, len(body) + 1)


def test_reference_decoder_refuses_truncated_gzip() -> None:
    with pytest.raises((OSError, EOFError, zlib.error)):
        gzip.decompress(COMPRESS["gzip"](b"content")[:-1])
