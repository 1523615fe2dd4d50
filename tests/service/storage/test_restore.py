"""Data folders that were put back from copies, or damaged: no file goes, and nothing wrong is served."""

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from service.__main__ import main
from service.access.keys import add_key
from service.commands import doctor
from service.commands.purge import purge
from service.errors import DataFolderError
from service.storage.database import FILE_NAME
from service.storage.store import Store
from tests.support.commands import run_main
from tests.support.server import Server, assert_problem
from tests.support.stores import LOCAL, add, receive


def stored(folder: Path) -> set[bytes]:
    """The contents of all files of measurements, wherever they are."""
    return {path.read_bytes() for path in folder.rglob("*") if path.is_file() and not path.name.startswith(FILE_NAME)}


def harm_page(folder: Path, name: str, content: bytes = b"") -> None:
    """Replace the first page of a table or an index, by zeros or by what is given."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as db:
        db.execute("PRAGMA journal_mode = DELETE")  # all of it is in the one file
        (page,) = db.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (name,)).fetchone()
        (size,) = db.execute("PRAGMA page_size").fetchone()
    with (folder / FILE_NAME).open("r+b") as file:
        file.seek((page - 1) * size)
        file.write(content.ljust(size, b"\0"))


def test_older_database_loses_no_file_and_an_upload_takes_it_back(
    own_server: Callable[..., Server], data: bytes, tmp_path: Path
) -> None:
    server = own_server(fits=False)
    server.stop()
    older = shutil.copy(server.data_dir / FILE_NAME, tmp_path / "older")
    sha256 = server.start().http.post("/v1/measurements", content=data).json()["sha256"]
    server.stop()
    shutil.copy(older, server.data_dir / FILE_NAME)
    server.start()
    assert_problem(server.http.get(f"/v1/measurements/{sha256}"), 404, "not-found")
    assert stored(server.data_dir) == {data}
    assert "1 files of measurements have no row; they are in the folder lost" in server.log.read_text()
    assert server.http.get("/health/ready").json()["lost_files"] == 1
    examined = run_main(doctor.main, "--data-dir", str(server.data_dir))
    assert examined.returncode == 1
    assert "WRONG  lost files:     1 files have no row" in examined.stdout
    assert server.http.post("/v1/measurements", content=data).status_code == 201
    assert server.http.get(f"/v1/measurements/{sha256}").content == data
    assert server.http.get("/health/ready").json()["lost_files"] == 0
    assert list((server.data_dir / "lost").iterdir()) == []


def test_rows_wait_for_their_files_and_take_them_back(store: Store, tmp_path: Path) -> None:
    contents = {add(store, content): content for content in (b"first", b"second")}
    store.close()
    copy = shutil.copy(tmp_path / FILE_NAME, tmp_path / "copy")
    with closing(sqlite3.connect(tmp_path / FILE_NAME)) as db, db:
        db.execute("DELETE FROM measurements")  # as in an older database
    with closing(Store(tmp_path)) as store:
        assert store.blobs.n_lost() == 2
    shutil.copy(copy, tmp_path / FILE_NAME)
    (tmp_path / "lost").rename(tmp_path / "later")  # the database came back before the measurements
    with closing(Store(tmp_path)) as store:
        assert store.warnings == ["the files of 2 measurements are missing; dsbrdf doctor names the first"]
        assert {row.sha256 for row in store.measurements("", 9, None)} == set(contents)
    (tmp_path / "later").rename(tmp_path / "lost")
    with closing(Store(tmp_path)) as store:
        assert (store.warnings, store.blobs.n_lost()) == ([], 0)
        assert {sha256: store.blobs.path(sha256).read_bytes() for sha256 in contents} == contents


def test_upload_in_the_place_of_other_bytes_keeps_them(store: Store, tmp_path: Path) -> None:
    first, second = add(store, b"first"), add(store, b"second")
    store.blobs.path(second).replace(store.blobs.path(first))
    assert not store.add_measurement(LOCAL, receive(store, b"first"))[1]
    assert stored(tmp_path) == {b"first", b"second"}
    assert store.blobs.damage(first) is None


EMPTY_TABLE, EMPTY_INDEX = (bytes([kind, 0, 0, 0, 0, 16, 0, 0]) for kind in (13, 10))  # a valid page without rows


@pytest.mark.parametrize(
    ("name", "content"),
    [("measurements", b""), ("fits", EMPTY_TABLE), ("keys", EMPTY_TABLE), ("measurements_by_sha256", EMPTY_INDEX)],
)
@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_damaged_table_or_index_is_refused_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, content: bytes, host: str
) -> None:
    monkeypatch.setattr("service.__main__._run", lambda *_: 0)  # it must not come to that
    store = Store(tmp_path)
    store.add_fit(LOCAL, add(store), {}, 10)
    add_key(store.database, "someone")
    store.close()
    harm_page(tmp_path, name, content)
    before = (tmp_path / FILE_NAME).read_bytes()
    refused = run_main(main, "--host", host, "--port", "0", "--data-dir", str(tmp_path))
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "restore the folder from a copy" in refused.stderr
    with pytest.raises(DataFolderError, match="restore the folder from a copy"):
        purge(tmp_path, 1e12)
    assert "WRONG  database: " in run_main(doctor.main, "--data-dir", str(tmp_path)).stdout
    assert (tmp_path / FILE_NAME).read_bytes() == before
    assert stored(tmp_path) == {b"content"}


@pytest.mark.parametrize("committed", [False, True])
def test_deletion_that_a_kill_breaks_off_is_undone_or_done(tmp_path: Path, committed: bool) -> None:
    store = Store(tmp_path)
    sha256 = add(store, b"content")
    removed = store.blobs.temporary / f"removed-{sha256}-0123abcd"
    store.blobs.path(sha256).rename(removed)
    if committed:
        with store.database.transaction() as db:
            db.execute("DELETE FROM measurements")
    store.close()
    with closing(Store(tmp_path)) as store:
        assert not removed.exists()
        assert (store.warnings, store.blobs.n_lost()) == ([], 0)
        assert store.blobs.path(sha256).exists() is not committed


def test_deletion_that_cannot_be_committed_keeps_the_file(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    transaction = store.database.transaction

    @contextmanager
    def broken_off() -> Iterator[sqlite3.Connection]:
        with transaction() as db:
            yield db
            raise sqlite3.OperationalError("database or disk is full")

    sha256 = add(store, b"content")
    monkeypatch.setattr(store.database, "transaction", broken_off)
    with pytest.raises(sqlite3.OperationalError, match="full"):
        store.remove_measurement("", sha256)
    monkeypatch.undo()
    assert store.blobs.damage(sha256) is None
    assert store.remove_measurement("", sha256)
    assert not stored(tmp_path)
