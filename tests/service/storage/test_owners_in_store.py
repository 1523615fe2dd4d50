"""Owners in the database: what is not yours does not exist, and results count as stored."""

import json
import sqlite3
from pathlib import Path

import pytest

import dsbrdf
from service.storage.quota import StorageQuotaError
from service.storage.rows import Caller, FitKey
from service.storage.schema import STEPS
from service.storage.store import Store
from service.wire.fit_options import to_wire

SHA256 = "ab" * 32


def write_version_1(folder: Path) -> None:
    """Make a data folder as the first release left it: rows deleted in between, fits in every state."""
    (folder / "blobs" / SHA256[:2]).mkdir(parents=True)
    (folder / "blobs" / SHA256[:2] / f"{SHA256}.binary").write_bytes(b"content")
    database = sqlite3.connect(folder / "dsbrdf.sqlite", isolation_level=None)
    database.execute("PRAGMA journal_mode = WAL")
    database.executescript(STEPS[0])
    database.execute("PRAGMA user_version = 1")
    database.execute(
        "INSERT INTO measurements (seq, sha256, size, valid_nodes, created) VALUES (7, ?, 7, 5, 10.0)", (SHA256,)
    )
    options = json.dumps(to_wire(dsbrdf.FitOptions()))
    query = (
        "INSERT INTO fits (seq, id, measurement, options, algorithm, library, status, attempts, metrics, error,"
        " created, started, finished, result) VALUES (?, ?, ?, ?, '1', '0', ?, ?, ?, ?, ?, ?, ?, ?)"
    )
    error = json.dumps({"origin": "input", "type": "T", "message": "M"})
    for row in (
        (2, "done", SHA256, options, "succeeded", 1, '{"male": 0.5}', None, 11.0, 12.0, 13.0, '{"é": 1}'),
        (3, "broken", SHA256, options, "failed", 2, None, error, 14.0, 15.0, 16.0, None),
        (5, "stopped", SHA256, options, "cancelled", 0, None, None, 17.0, None, 18.0, None),
        (8, "busy", SHA256, options, "running", 1, None, None, 19.0, 20.0, None, None),
        (9, "waiting", SHA256, options, "accepted", 0, None, None, 21.0, None, None, None),
    ):
        database.execute(query, row)
    database.close()


def test_database_without_owners_is_migrated_to_the_local_user(tmp_path: Path) -> None:
    write_version_1(tmp_path)
    before = sqlite3.connect(tmp_path / "dsbrdf.sqlite")
    old = {
        table: before.execute(f"SELECT * FROM {table} ORDER BY seq").fetchall() for table in ("measurements", "fits")
    }
    names = [column[1] for column in before.execute("PRAGMA table_info(fits)")]
    before.close()

    store = Store(tmp_path)
    (measurement,) = store.measurements("", 10, None)
    assert (measurement.owner, *old["measurements"][0]) == tuple(vars(measurement).values())
    assert [row.seq for row in store.fits("", 10, None)] == [9, 8, 5, 3, 2]
    assert store.result(FitKey("", "done")) == '{"é": 1}'
    assert [row.id for row in store.resume()] == ["waiting", "busy"]
    new, is_new = store.add_fit(Caller(), "new", SHA256, {}, ("1", "0"), 10)
    assert (new.seq, is_new) == (10, True)
    assert store.measurement("someone", SHA256) is None
    assert store.fit(FitKey("someone", "done")) is None
    assert store.blobs.path(SHA256).read_bytes() == b"content"
    store.close()

    after = sqlite3.connect(tmp_path / "dsbrdf.sqlite")
    assert after.execute("PRAGMA user_version").fetchone() == (len(STEPS),)
    kept = after.execute(f"SELECT {', '.join(names)} FROM fits WHERE seq NOT IN (8, 10) ORDER BY seq")
    assert kept.fetchall() == [row for row in old["fits"] if row[names.index("id")] != "busy"]
    assert after.execute("SELECT owner, size FROM fits WHERE id = 'done'").fetchone() == ("", len('{"é": 1}'.encode()))
    assert after.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    after.close()
    Store(tmp_path).close()


def place(store: Store, owner: str, content: bytes) -> str:
    incoming = store.blobs.incoming()
    incoming.write(content)
    sha256 = incoming.close()
    row, new = store.add_measurement(Caller(owner), incoming, sha256, 1)
    incoming.discard()
    assert new
    assert row.owner == owner
    return sha256


def test_owners_share_only_the_file_of_a_measurement(tmp_path: Path) -> None:
    store = Store(tmp_path)
    sha256 = place(store, "a", b"x")
    place(store, "a", b"y")
    assert place(store, "b", b"x") == sha256
    assert [row.seq for row in store.measurements("b", 10, None)] == [1]
    assert [row.seq for row in store.measurements("a", 10, None)] == [2, 1]
    for owner in "ab":
        row, new = store.add_fit(Caller(owner), "f", sha256, {}, ("1", "0"), 10)
        assert new
        assert row.key == FitKey(owner, "f")
    assert store.start_fit(FitKey("b", "f")) is not None
    assert store.complete_fit(FitKey("b", "f"), "of b", {}) is not None
    fit = store.fit(FitKey("a", "f"))
    assert fit is not None
    assert fit.status == "accepted"
    assert store.result(FitKey("a", "f")) is None
    assert store.remove_measurement("b", sha256)  # a's fit of it is unfinished, b's is not
    assert store.blobs.path(sha256).exists()
    assert not store.remove_measurement("b", sha256)
    assert store.cancel_fit(FitKey("a", "f")) is not None
    assert store.remove_measurement("a", sha256)
    assert not store.blobs.path(sha256).exists()
    assert store.result(FitKey("b", "f")) == "of b"
    store.close()


def test_stored_bytes_include_results(tmp_path: Path) -> None:
    store = Store(tmp_path)
    sha256 = place(store, "a", b"12345")

    def submit(fit_id: str, most: int) -> None:
        assert store.add_fit(Caller("a", stored_bytes=most), fit_id, sha256, {}, ("1", "0"), 10)[1]

    submit("f", 6)
    store.start_fit(FitKey("a", "f"))
    store.complete_fit(FitKey("a", "f"), "é", {})
    with pytest.raises(StorageQuotaError, match="stored"):
        submit("g", 7)
    submit("g", 8)
    assert store.remove_fit(FitKey("a", "f"))
    with pytest.raises(StorageQuotaError):
        submit("h", 5)
    submit("h", 6)
    store.close()
