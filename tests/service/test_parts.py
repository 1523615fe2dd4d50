"""Parts of the service on their own: decoders, options, store, preferences."""

import asyncio
import gzip
import zlib
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from starlette.requests import Request
from starlette.types import Message

import dsbrdf
from service.errors import DataFolderInUseError, MeasurementNotFoundError, ProblemError
from service.http.request_body import PIECE, decoder
from service.http.responses import OpenFileResponse, preferred_wait
from service.jobs.jobs import fit_identity
from service.storage.blobs import Blobs
from service.storage.schema import Caller, FitKey
from service.storage.store import Store
from service.wire.fit_options import DEFAULTS, from_query, from_wire, to_wire

LOCAL = Caller()
FIT = FitKey("", "f")


def decode(encoding: str, body: bytes, step: int) -> bytes:
    parts: list[bytes] = []
    stage = decoder(encoding, parts.append)
    for start in range(0, len(body), step):
        stage.feed(body[start : start + step])
    stage.finish()
    assert all(len(part) <= PIECE for part in parts) or not encoding
    return b"".join(parts)


@given(st.lists(st.binary(max_size=200).map(lambda b: b * 50), max_size=4), st.integers(1, 5000), st.sampled_from("gz"))
def test_members_on_end_decode_whatever_the_pieces(contents: list[bytes], step: int, kind: str) -> None:
    if kind == "g":
        body = b"".join(gzip.compress(content) for content in contents)
        assert decode("gzip", body, step) == b"".join(contents)
    else:
        body = b"".join(zstandard.ZstdCompressor().compress(content) for content in contents)
        assert decode("zstd", body, step) == b"".join(contents)


@pytest.mark.parametrize("size", [PIECE - 1, PIECE, PIECE + 1, 3 * PIECE, 10 * PIECE])
def test_large_members_come_out_whole(size: int) -> None:
    content = np.random.default_rng(0).integers(0, 4, size, dtype=np.uint8).tobytes()
    for flat in (bytes(size), content):
        assert decode("gzip", gzip.compress(flat), 1 << 20) == flat
        assert decode("zstd", zstandard.ZstdCompressor().compress(flat), 1 << 20) == flat


@given(st.binary(max_size=300), st.integers(1, 400))
def test_noise_is_refused_or_decodes_as_zlib_does(noise: bytes, step: int) -> None:
    try:
        expected = gzip.decompress(noise) if noise else b""
    except (OSError, EOFError, zlib.error):
        with pytest.raises(ProblemError, match="not valid gzip"):
            decode("gzip", noise, step)
    else:
        assert decode("gzip", noise, step) == expected


def test_a_large_window_is_refused() -> None:
    parameters = zstandard.ZstdCompressionParameters(window_log=27, enable_ldm=True)
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
    body = compressor.compress(bytes(1000)) + compressor.flush()
    with pytest.raises(ProblemError, match="window is larger than 8388608 bytes"):
        decode("zstd", body, 100)


def test_a_missing_dictionary_is_named() -> None:
    words: list[bytes | bytearray | memoryview] = [b"theta_half %d of %d" % (i, i * i) for i in range(5000)]
    dictionary = zstandard.train_dictionary(4096, words)
    body = zstandard.ZstdCompressor(dict_data=dictionary).compress(words[7])
    with pytest.raises(ProblemError, match="dictionary"):
        decode("zstd", body, 100)


@pytest.mark.parametrize(
    ("header", "of_zstd"),
    [("gzip, identity", False), ("identity,GZIP", False), ("", None), (",", None), ("zstd,", True)],
)
def test_identity_in_a_list_of_encodings_is_nothing(header: str, of_zstd: bool | None) -> None:
    body = b"body" if of_zstd is None else zstandard.compress(b"body") if of_zstd else gzip.compress(b"body")
    assert decode(header, body, 3) == b"body"


def test_options_keep_their_values_on_the_wire() -> None:
    for options in (
        dsbrdf.FitOptions(),
        dsbrdf.FitOptions(horizon_cutoff=None, n_lobes=8, robust=True),
        dsbrdf.FitOptions(horizon_cutoff=float(np.radians(71.3))),
        dsbrdf.FitOptions(method="global", knots=tuple(np.radians([0.0, 17.0, 60.0, 80.0]).tolist())),
    ):
        wire = to_wire(options)
        assert to_wire(from_wire(wire)) == wire
        assert from_wire(wire) == from_wire(wire)
    assert from_wire({}) == dsbrdf.FitOptions()
    assert from_wire(DEFAULTS) == dsbrdf.FitOptions()
    assert from_query([("horizon_cutoff_deg", "None")]).horizon_cutoff is None
    assert from_query([("knots_deg", "0,30,60.0")]).knots == tuple(np.radians([0.0, 30.0, 60.0]).tolist())
    with pytest.raises(dsbrdf.InvalidArgumentError, match="increasing"):
        from_query([("knots_deg", "30,20")])
    with pytest.raises(dsbrdf.InvalidArgumentError, match="more than once"):
        from_query([("n_lobes", "2"), ("n_lobes", "2")])


def test_a_fit_s_identity_is_of_its_measurement_options_and_algorithm(monkeypatch: pytest.MonkeyPatch) -> None:
    base = fit_identity("a" * 64, to_wire(dsbrdf.FitOptions()))
    assert base == fit_identity("a" * 64, to_wire(dsbrdf.FitOptions(horizon_cutoff=float(np.radians(80)) + 1e-14)))
    others = {
        fit_identity("b" * 64, to_wire(dsbrdf.FitOptions())),
        fit_identity("a" * 64, to_wire(dsbrdf.FitOptions(n_lobes=2))),
    }
    monkeypatch.setattr(dsbrdf, "ALGORITHM_VERSION", "another")
    others.add(fit_identity("a" * 64, to_wire(dsbrdf.FitOptions())))
    assert len(others | {base}) == 4


def test_a_row_that_has_ended_cannot_change(tmp_path: Path) -> None:
    store = Store(tmp_path)
    incoming = store.blobs.incoming()
    incoming.write(b"content")
    sha256 = incoming.close()
    store.add_measurement(LOCAL, incoming, sha256, 1)
    arguments = (sha256, to_wire(dsbrdf.FitOptions()), ("1", "0"), 10)
    with pytest.raises(MeasurementNotFoundError):
        store.add_fit(LOCAL, "f", "other", {}, ("1", "0"), 10)
    row, new = store.add_fit(LOCAL, "f", *arguments)
    assert (row.status, new) == ("accepted", True)
    assert store.complete_fit(FIT, "document", {}) is None  # it does not run
    assert store.start_fit(FIT) is not None
    assert store.start_fit(FIT) is None
    assert not store.remove_fit(FIT)
    assert store.complete_fit(FIT, "document", {"male": 0.5}) is not None
    for refused in (store.cancel_fit(FIT), store.fail_fit(FIT, {}), store.requeue_fit(FIT), store.start_fit(FIT)):
        assert refused is None
    row, new = store.add_fit(LOCAL, "f", *arguments)
    assert (row.status, new, row.metrics, store.result(FIT)) == ("succeeded", False, {"male": 0.5}, "document")
    assert store.remove_fit(FIT)
    assert store.fit(FIT) is None
    store.close()


@pytest.mark.parametrize(("origin", "repeats"), [("input", False), ("compute", True), ("system", True)])
def test_failures_that_are_not_the_input_s_run_again(tmp_path: Path, origin: str, repeats: bool) -> None:
    store = Store(tmp_path)
    incoming = store.blobs.incoming()
    sha256 = incoming.close()
    store.add_measurement(LOCAL, incoming, sha256, 1)
    arguments = (sha256, to_wire(dsbrdf.FitOptions()), ("1", "0"), 10)
    store.add_fit(LOCAL, "f", *arguments)
    store.start_fit(FIT)
    store.fail_fit(FIT, {"origin": origin, "type": "T", "message": "M"})
    assert store.add_fit(LOCAL, "f", *arguments)[1] is repeats
    store.close()


def test_a_folder_is_opened_once_and_again_after_it_is_closed(tmp_path: Path) -> None:
    first = Store(tmp_path)
    with pytest.raises(DataFolderInUseError, match="in use"):
        Store(tmp_path)
    first.close()
    Store(tmp_path).close()


def test_a_measurement_that_has_lost_its_file_takes_it_again(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for expected_new in (True, False):
        incoming = store.blobs.incoming()
        incoming.write(b"content")
        sha256 = incoming.close()
        assert store.add_measurement(LOCAL, incoming, sha256, 1)[1] is expected_new
        assert store.blobs.path(sha256).read_bytes() == b"content"
        store.blobs.remove(sha256)
    store.close()


def test_a_discarded_file_is_gone_and_a_placed_one_stays(tmp_path: Path) -> None:
    blobs = Blobs(tmp_path)
    dropped, kept = blobs.incoming(), blobs.incoming()
    dropped.write(b"a")
    dropped.discard()
    dropped.discard()
    kept.write(b"b")
    sha256 = kept.close()
    blobs.place(kept, sha256)
    kept.discard()
    assert list(blobs.all()) == [sha256]
    assert blobs.path(sha256).read_bytes() == b"b"
    assert not list((tmp_path / "tmp").iterdir())


def test_a_file_that_is_deleted_before_its_first_byte_is_sent_whole(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"content")
    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        await asyncio.sleep(60)
        return {"type": "http.disconnect"}

    response = OpenFileResponse(path, {}, "text/plain")
    path.unlink()
    scope = {"type": "http", "method": "GET", "headers": [(b"range", b"bytes=3-")]}
    asyncio.run(response(scope, receive, send))
    assert sent[0]["status"] == 206
    assert b"".join(message.get("body", b"") for message in sent) == b"tent"
    with pytest.raises(FileNotFoundError):
        OpenFileResponse(path, {}, "text/plain")


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        (None, 30.0),
        ("wait=5", 5.0),
        ('wait="5"', 5.0),
        ("WAIT = 5", 5.0),
        ("return=minimal, wait=5; x=y", 5.0),
        ("respond-async", 0.0),
        ("wait=5, respond-async", 5.0),
        ("respond-async, wait=5", 5.0),
        ("respond-async, wait=x", 0.0),
        ("wait=5, wait=6", 5.0),
        ('foo="a, wait=5"', 30.0),
        ('foo="a, wait=5", wait=6', 6.0),
        ("wait=1000", 60.0),
        ("wait=x", 30.0),
        ("wait=-1", 30.0),
        ("wait=nan", 30.0),
        ("wait", 30.0),
        ("=;,,", 30.0),
    ],
)
def test_the_preferred_wait(header: str | None, seconds: float) -> None:
    headers = [] if header is None else [(b"prefer", header.encode())]
    request = Request({"type": "http", "headers": headers})
    assert preferred_wait(request, 30.0, 60.0) == seconds
