"""Decoders of request bodies: what comes in any pieces, and however damaged, is decoded right or refused."""

import gzip
import struct

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from dsbrdf_service.errors import ProblemError
from dsbrdf_service.http.request_body import PIECE, decoder
from tests.support.strategies import examples

LIMIT = 1 << 20  # what the sink of these tests takes
COMPRESS = {
    "gzip": lambda content: gzip.compress(content, 1),
    "zstd": zstandard.ZstdCompressor(level=1, write_checksum=True).compress,
}
SKIPPABLE = struct.pack("<II", 0x184D2A50, 3) + b"abc"

encodings = st.sampled_from([*COMPRESS])
# Each part of a body: a few bytes and how often they are repeated.
contents = st.lists(
    st.builds(bytes.__mul__, st.binary(max_size=60), st.one_of(st.integers(0, 5), st.integers(1, 30_000))), max_size=4
)
steps = st.one_of(st.integers(1, 40), st.integers(1, 1 << 21))


def decoded(encoding: str, body: bytes, step: int) -> bytes | str:
    """What a body decodes to when it comes in pieces of `step` bytes, or the sentence that refuses it."""
    parts: list[bytes] = []
    seen = 0

    def sink(data: bytes) -> None:
        nonlocal seen
        assert len(data) <= PIECE or not encoding
        seen += len(data)
        if seen > LIMIT:
            raise ProblemError("too-large", "The body is too long.")
        parts.append(data)

    try:
        feed, finish = decoder(encoding, sink)
        for start in range(0, len(body), step):
            feed(body[start : start + step])
        finish()
    except ProblemError as error:
        return error.detail
    finally:
        assert seen <= LIMIT + PIECE  # no more is decoded than the first piece that is too much
    return b"".join(parts)


def whole_body(encoding: str, parts: list[bytes]) -> bytes:
    return b"".join(COMPRESS[encoding](part) for part in parts)


@examples(1)
@given(encoding=encodings, parts=contents, step=steps, skipped=st.booleans())
def test_concatenated_members_decode_or_exceed_the_limit(
    encoding: str, parts: list[bytes], step: int, skipped: bool
) -> None:
    whole, body = b"".join(parts), whole_body(encoding, parts)
    if skipped and encoding == "zstd":
        body = SKIPPABLE + body + SKIPPABLE
    expected = "The body is too long." if len(whole) > LIMIT else whole
    assert decoded(encoding, body, max(step, len(body) // 2000)) == expected


@pytest.mark.parametrize("size", [PIECE - 1, PIECE, PIECE + 1, LIMIT])
@pytest.mark.parametrize("encoding", COMPRESS)
def test_large_member_decodes_completely(encoding: str, size: int) -> None:
    content = np.random.default_rng(0).integers(0, 4, size, dtype=np.uint8).tobytes()
    for flat in (bytes(size), content):
        assert decoded(encoding, COMPRESS[encoding](flat), 1 << 20) == flat


@examples(3)
@given(
    encoding=encodings, content=st.binary(max_size=400), cut=st.floats(0, 1, exclude_max=True), step=st.integers(1, 500)
)
def test_truncated_body_is_refused(encoding: str, content: bytes, cut: float, step: int) -> None:
    body = COMPRESS[encoding](content)
    part = body[: int(cut * len(body))]
    for start, whole in ((b"", b""), (COMPRESS[encoding](b"first"), b"first")):
        answer = decoded(encoding, start + part, step)
        assert answer == whole if not part else "is not valid" in str(answer)


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
    encoding: str, parts: list[bytes], changes: list[tuple[float, bytes]], step: int
) -> None:
    body = bytearray(whole_body(encoding, parts))
    for place, content in changes:
        start = int(place * len(body))
        body[start : start + len(content)] = content
    whole = decoded(encoding, bytes(body), len(body) + 1)
    assert decoded(encoding, bytes(body), max(step, len(body) // 2000)) == whole
    if encoding == "gzip" and isinstance(whole, bytes):
        assert whole == (gzip.decompress(bytes(body)) if body else b"")


def test_zstd_frame_with_wrong_length_gets_one_result_in_any_chunks() -> None:
    body = bytearray(COMPRESS["zstd"](b""))
    body[5] = 1  # the length of the content, which zstd compares only for a frame that it has whole
    whole = decoded("zstd", bytes(body), len(body))
    assert {decoded("zstd", bytes(body), step) for step in range(1, len(body))} == {whole}


def test_zstd_frame_that_needs_much_memory_or_a_dictionary_is_refused() -> None:
    parameters = zstandard.ZstdCompressionParameters(window_log=27, enable_ldm=True)
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
    body = compressor.compress(bytes(1000)) + compressor.flush()
    assert "window is larger than 8388608 bytes" in str(decoded("zstd", body, 100))
    words: list[bytes | bytearray | memoryview] = [b"theta_half %d of %d" % (i, i * i) for i in range(5000)]
    dictionary = zstandard.train_dictionary(4096, words)
    assert "dictionary" in str(decoded("zstd", zstandard.ZstdCompressor(dict_data=dictionary).compress(words[7]), 100))


@pytest.mark.parametrize(
    ("header", "of_zstd"),
    [("gzip, identity", False), ("identity,GZIP", False), ("", None), (",", None), ("zstd,", True)],
)
def test_identity_encoding_is_ignored(header: str, of_zstd: bool | None) -> None:
    body = b"body" if of_zstd is None else zstandard.compress(b"body") if of_zstd else gzip.compress(b"body")
    assert decoded(header, body, 3) == b"body"
