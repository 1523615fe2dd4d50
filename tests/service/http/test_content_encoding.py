"""Decoders of request bodies, on their own."""

import gzip
import zlib

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from service.errors import ProblemError
from service.http.request_body import PIECE, decoder


def decode(encoding: str, body: bytes, step: int) -> bytes:
    parts: list[bytes] = []
    stage = decoder(encoding, parts.append)
    for start in range(0, len(body), step):
        stage.feed(body[start : start + step])
    stage.finish()
    assert all(len(part) <= PIECE for part in parts) or not encoding
    return b"".join(parts)


@given(st.lists(st.binary(max_size=200).map(lambda b: b * 50), max_size=4), st.integers(1, 5000), st.sampled_from("gz"))
def test_concatenated_members_decode_in_any_chunks(contents: list[bytes], step: int, kind: str) -> None:
    if kind == "g":
        body = b"".join(gzip.compress(content) for content in contents)
        assert decode("gzip", body, step) == b"".join(contents)
    else:
        body = b"".join(zstandard.ZstdCompressor().compress(content) for content in contents)
        assert decode("zstd", body, step) == b"".join(contents)


@pytest.mark.parametrize("size", [PIECE - 1, PIECE, PIECE + 1, 3 * PIECE, 10 * PIECE])
def test_large_member_decodes_completely(size: int) -> None:
    content = np.random.default_rng(0).integers(0, 4, size, dtype=np.uint8).tobytes()
    for flat in (bytes(size), content):
        assert decode("gzip", gzip.compress(flat), 1 << 20) == flat
        assert decode("zstd", zstandard.ZstdCompressor().compress(flat), 1 << 20) == flat


@given(st.binary(max_size=300), st.integers(1, 400))
def test_random_bytes_are_refused_or_decode_as_zlib_does(noise: bytes, step: int) -> None:
    try:
        expected = gzip.decompress(noise) if noise else b""
    except (OSError, EOFError, zlib.error):
        with pytest.raises(ProblemError, match="not valid gzip"):
            decode("gzip", noise, step)
    else:
        assert decode("gzip", noise, step) == expected


def test_zstd_frame_with_large_window_is_refused() -> None:
    parameters = zstandard.ZstdCompressionParameters(window_log=27, enable_ldm=True)
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
    body = compressor.compress(bytes(1000)) + compressor.flush()
    with pytest.raises(ProblemError, match="window is larger than 8388608 bytes"):
        decode("zstd", body, 100)


def test_zstd_frame_with_dictionary_is_refused() -> None:
    words: list[bytes | bytearray | memoryview] = [b"theta_half %d of %d" % (i, i * i) for i in range(5000)]
    dictionary = zstandard.train_dictionary(4096, words)
    body = zstandard.ZstdCompressor(dict_data=dictionary).compress(words[7])
    with pytest.raises(ProblemError, match="dictionary"):
        decode("zstd", body, 100)


@pytest.mark.parametrize(
    ("header", "of_zstd"),
    [("gzip, identity", False), ("identity,GZIP", False), ("", None), (",", None), ("zstd,", True)],
)
def test_identity_encoding_is_ignored(header: str, of_zstd: bool | None) -> None:
    body = b"body" if of_zstd is None else zstandard.compress(b"body") if of_zstd else gzip.compress(b"body")
    assert decode(header, body, 3) == b"body"
