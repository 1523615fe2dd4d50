"""The data folder: what is not the service's is left as it is, and no copy or damage costs a file."""

import os
import shutil
import sqlite3
import stat
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from dsbrdf_service.__main__ import main
from dsbrdf_service.access.keys import add_key
from dsbrdf_service.commands import doctor
from dsbrdf_service.commands.purge import purge
from dsbrdf_service.errors import DataFolderError
from dsbrdf_service.storage.database import FILE_NAME, Database
from dsbrdf_service.storage.store import Store
from tests.support.commands import run_main
from tests.support.server import Server, assert_problem
from tests.support.stores import LOCAL, add, receive

pytestmark = pytest.mark.slow


def make_folder(path: Path) -> None:
    (path / "pymp-a").mkdir(parents=True)
    for name in ("pymp-a/thesis.tex", "upload-1"):  # as the service names what it removes from its own folders
        (path / name).write_text("mine")


def make_database(path: Path) -> None:
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("CREATE TABLE theirs (a INTEGER)")


def link_to(name: str) -> Callable[[Path], None]:
    return lambda path: path.symlink_to(path.parents[1] / "outside" / name)


MAKE: dict[str, Callable[[Path], object]] = {
    "nothing": lambda path: path.touch(),
    "a byte": lambda path: path.write_bytes(b"S"),
    "a file": lambda path: path.write_bytes(b"no database" * 500),
    "a database": make_database,
    "a folder": make_folder,
    "a link to a file": link_to("upload-1"),
    "a link to a folder": link_to("pymp-a"),
    "a link to nothing": link_to("nothing"),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that does not exist, beside one that symbolic links lead to."""
    make_folder(tmp_path / "outside")
    return tmp_path / "data"


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Return what the service says when it does not take a folder, in one sentence."""
    monkeypatch.setattr("dsbrdf_service.__main__._run", lambda *_: 0)  # it must not come to that

    def start(folder: Path, *words: str) -> str:
        done = run_main(main, "--data-dir", str(folder), "--port", "0", *words)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        return done.stderr

    return start


def snapshot(folder: Path) -> dict[str, tuple[int, int, object]]:
    """Everything below a folder: what it is, when it was changed and what is in it."""
    found: dict[str, tuple[int, int, object]] = {}
    for path in sorted(folder.rglob("*")):
        content = path.readlink() if path.is_symlink() else path.read_bytes() if path.is_file() else None
        status = path.lstat()
        found[str(path.relative_to(folder))] = (stat.S_IFMT(status.st_mode), status.st_mtime_ns, content)
    return found


@pytest.mark.parametrize("kind", MAKE)
@pytest.mark.parametrize("names", [[FILE_NAME, "a letter"], [FILE_NAME, "blobs"], [f"{FILE_NAME}-wal"], ["tmp", "run"]])
def test_folder_that_is_not_the_services_is_refused_and_left_as_it_is(
    folder: Path, refused: Callable[..., str], kind: str, names: list[str]
) -> None:
    folder.mkdir()
    for name in names:
        MAKE[kind](folder / name)
    before = snapshot(folder.parent)
    assert ("another program's" in refused(folder)) is (kind == "a database" and FILE_NAME in names)
    assert snapshot(folder.parent) == before


@pytest.mark.parametrize("kind", ["a file", "a link to a folder", "a link to nothing"])
@pytest.mark.parametrize("name", ["run", "tmp", "blobs"])
def test_what_is_in_the_place_of_a_folder_is_named_and_left_as_it_is(
    folder: Path, refused: Callable[..., str], kind: str, name: str
) -> None:
    Database(folder).close()
    MAKE[kind](folder / name)
    before = {path: what for path, what in snapshot(folder.parent).items() if name in path or "outside" in path}
    assert f"{folder / name} is not a folder" in refused(folder)
    assert snapshot(folder.parent).items() >= before.items()


def test_folder_of_the_service_loses_nothing_that_others_have_put_there(folder: Path) -> None:
    Database(folder).close()
    for kind, make in MAKE.items():
        for place in (folder, folder / "blobs", folder / "tmp", folder / "run", folder / "work"):
            place.mkdir(exist_ok=True)
            make(place / kind)
    misplaced = folder / "blobs" / "00" / f"{'1' * 64}.binary"
    misplaced.parent.mkdir()
    misplaced.touch()
    before = {path: what for path, what in snapshot(folder.parent).items() if not stat.S_ISDIR(what[0])}
    before.pop(f"data/{FILE_NAME}")
    Store(folder).close()
    assert snapshot(folder.parent).items() >= before.items()


def test_folder_of_a_start_that_was_killed_is_taken(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).touch()
    Store(tmp_path).close()


def test_new_folder_and_the_database_in_any_are_for_their_user_alone(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        for folder, mode in ((tmp_path / "new", 0o700), (tmp_path / "others can read", 0o755)):
            if mode == 0o755:
                folder.mkdir()
            with closing(Store(folder)):
                modes = {stat.S_IMODE(path.stat().st_mode) for path in folder.glob(f"{FILE_NAME}*")}
            assert (stat.S_IMODE(folder.stat().st_mode), modes) == (mode, {0o600})
    finally:
        os.umask(before)


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
    tmp_path: Path, refused: Callable[..., str], name: str, content: bytes, host: str
) -> None:
    store = Store(tmp_path)
    store.add_fit(LOCAL, add(store), {}, 10)
    add_key(store.database, "someone")
    store.close()
    harm_page(tmp_path, name, content)
    before = (tmp_path / FILE_NAME).read_bytes()
    assert "restore the folder from a copy" in refused(tmp_path, "--host", host)
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
