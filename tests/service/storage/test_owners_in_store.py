"""Owners in the database: what is not yours does not exist, and results count as stored."""

import sqlite3
from functools import partial
from pathlib import Path

import pytest

from service.errors import DataFolderError, ProblemError
from service.storage.database import Database
from service.storage.schema import ROW_SIZE, Caller, FitKey
from service.storage.store import Store, fit_identity
from service.storage.uploads import Received


def test_database_with_other_tables_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    Store(tmp_path).close()
    file = tmp_path / "dsbrdf.sqlite"
    database = sqlite3.connect(file, isolation_level=None)
    database.execute("ALTER TABLE keys DROP COLUMN metrics")
    database.execute("PRAGMA user_version = 1")  # as an older release has numbered it
    database.close()
    before = file.read_bytes()
    for open_folder in (Store, partial(Database, exclusive=False)):
        with pytest.raises(DataFolderError, match=r"made by another release.* serve it with that release, or give"):
            open_folder(tmp_path)
    assert file.read_bytes() == before


def place(store: Store, owner: str, content: bytes) -> str:
    incoming = store.blobs.incoming()
    incoming.write(content)
    sha256 = incoming.close()
    row, new = store.add_measurement(Caller(owner), Received(incoming, sha256, 1))
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
    fit_id = fit_identity(sha256, {})
    for owner in "ab":
        row, new = store.add_fit(Caller(owner), sha256, {}, 10)
        assert new
        assert row.key == FitKey(owner, fit_id)
    assert store.start_fit(FitKey("b", fit_id)) is not None
    assert store.complete_fit(FitKey("b", fit_id), "of b", {}) is not None
    fit = store.fit(FitKey("a", fit_id))
    assert fit is not None
    assert fit.status == "accepted"
    assert store.result(FitKey("a", fit_id)) is None
    assert store.remove_measurement("b", sha256)  # a's fit of it is unfinished, b's is not
    assert store.blobs.path(sha256).exists()
    assert not store.remove_measurement("b", sha256)
    assert store.cancel_fit(FitKey("a", fit_id)) is not None
    assert store.remove_measurement("a", sha256)
    assert not store.blobs.path(sha256).exists()
    assert store.result(FitKey("b", fit_id)) == "of b"
    store.close()


def test_stored_bytes_include_results(tmp_path: Path) -> None:
    store = Store(tmp_path)
    sha256 = place(store, "a", b"12345")

    def submit(name: str, most: int) -> FitKey:
        row, new = store.add_fit(Caller("a", stored_bytes=most), sha256, {"name": name}, 10)
        assert new
        return row.key

    first = submit("f", 6)
    store.start_fit(first)
    store.complete_fit(first, "é", {})
    with pytest.raises(ProblemError, match="stored"):
        submit("g", ROW_SIZE + 7)
    submit("g", ROW_SIZE + 8)
    assert store.remove_fit(first)
    with pytest.raises(ProblemError):
        submit("h", ROW_SIZE + 5)
    submit("h", ROW_SIZE + 6)
    store.close()
