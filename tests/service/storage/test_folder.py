"""The data folder: what is not the service's is left as it is, and no copy or damage costs a file."""

import os
import shutil
import sqlite3
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from dsbrdf.samples.table_options import TableOptions
from dsbrdf_service.admin.commands import doctor
from dsbrdf_service.admin.serve import main
from dsbrdf_service.compute.steps import conversion_step
from dsbrdf_service.errors import DataFolderError, MeasurementDamagedError
from dsbrdf_service.storage.database import FILE_NAME, Database
from dsbrdf_service.storage.files import Incoming
from dsbrdf_service.storage.keys import add_key
from dsbrdf_service.storage.maintenance import purge_folder, remove_rows
from dsbrdf_service.storage.store import Store
from tests.support.command_line import run_main
from tests.support.server import LOCAL, add, receive

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
    monkeypatch.setattr("dsbrdf_service.admin.serve._run", lambda *_: 0)  # it must not come to that

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
def test_foreign_folder_is_left_alone(folder: Path, refused: Callable[..., str], kind: str, names: list[str]) -> None:
    folder.mkdir()
    for name in names:
        MAKE[kind](folder / name)
    before = snapshot(folder.parent)
    assert ("another program" in refused(folder)) is (kind == "a database" and FILE_NAME in names)
    assert snapshot(folder.parent) == before


@pytest.mark.parametrize("kind", ["a file", "a link to a folder", "a link to nothing"])
@pytest.mark.parametrize("name", ["run", "tmp", "blobs"])
def test_what_replaces_a_folder_is_named_and_kept(
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
    unfinished = [folder / place / "upload-1" for place in ("tmp", "blobs")]
    for path in unfinished:
        path.touch()
    Store(folder).close()
    assert snapshot(folder.parent).items() >= before.items()
    assert not any(path.exists() for path in unfinished)


@pytest.mark.parametrize("name", [FILE_NAME, f"{FILE_NAME}-journal"])
def test_folder_of_a_start_that_was_killed_is_taken(tmp_path: Path, name: str) -> None:
    for made in {FILE_NAME, name}:
        (tmp_path / made).touch()
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
    return {path.read_bytes() for path in folder.rglob("*") if path.is_file() and not path.name.startswith("dsbrdf.")}


def harm_page(folder: Path, name: str, content: bytes = b"") -> None:
    """Replace the first page of a table or an index, by zeros or by what is given."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as db:
        db.execute("PRAGMA journal_mode = DELETE")  # all of it is in the one file
        (page,) = db.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (name,)).fetchone()
        (size,) = db.execute("PRAGMA page_size").fetchone()
    with (folder / FILE_NAME).open("r+b") as file:
        file.seek((page - 1) * size)
        file.write(content.ljust(size, b"\0"))


def test_older_database_loses_no_file_and_an_upload_makes_its_row_again(tmp_path: Path) -> None:
    folder, older = tmp_path / "data", tmp_path / "older"
    Store(folder).close()
    shutil.copy(folder / FILE_NAME, older)
    with closing(Store(folder)) as store:
        sha256 = add(store)
    shutil.copy(older, folder / FILE_NAME)
    with closing(Store(folder)) as store:
        assert store.measurements("", 9, None) == []
        examined = run_main(doctor, "--data-dir", str(folder))
        assert examined.returncode == 1
        assert "WRONG  files:          1 of 1 files have no row" in examined.stdout
        assert add(store) == sha256
        assert stored(folder) == {b"content"}
        assert run_main(doctor, "--data-dir", str(folder)).returncode == 0


def test_files_without_rows_go_only_when_that_is_asked_for(store: Store, tmp_path: Path) -> None:
    first, second = add(store, b"first"), add(store, b"second")
    with store.database.transaction() as db:
        db.execute("DELETE FROM measurements WHERE sha256 = ?", (second,))
    assert purge_folder(tmp_path, 0.0) == {"fits": 0, "measurements": 0, "files_without_rows": 0, "bytes": 0}
    assert store.blobs.path(second).exists()
    purged = purge_folder(tmp_path, None, files_without_rows=True)
    assert purged == {"fits": 0, "measurements": 0, "files_without_rows": 1, "bytes": len(b"second")}
    assert not store.blobs.path(second).exists()
    assert store.measurement_file("", first)[1].read_bytes() == b"first"
    (tmp_path / "tmp").rmdir()  # A restored copy may lack empty folders.
    assert purge_folder(tmp_path, 1e12)["bytes"] == len(b"first")


@pytest.mark.parametrize("harm", [b"other", b"anything else", None])
def test_upload_mends_what_is_in_the_place_of_its_file(store: Store, harm: bytes | None) -> None:
    sha256 = add(store, b"first")
    path = store.blobs.path(sha256)
    path.unlink()
    os.mkfifo(path) if harm is None else path.write_bytes(harm)
    for _ in range(2):  # What was read once is no reason to believe it.
        with pytest.raises(MeasurementDamagedError):
            store.measurement_file("", sha256)
    assert not store.add_measurement(LOCAL, receive(store, b"first"))[1]
    assert store.measurement_file("", sha256)[1].read_bytes() == b"first"


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
        purge_folder(tmp_path, 1e12)
    assert "WRONG  database: " in run_main(doctor, "--data-dir", str(tmp_path)).stdout
    assert (tmp_path / FILE_NAME).read_bytes() == before
    assert stored(tmp_path) == {b"content"}


def test_what_the_user_may_not_do_is_no_damage(refused: Callable[..., str]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        Store(folder).close()
        (folder / FILE_NAME).chmod(0o444)
        folder.chmod(0o555)
        user = os.geteuid()
        if user == 0:  # who may do everything
            os.seteuid(65534)
        try:
            said = [refused(folder), refused(folder, "--host", "0.0.0.0")]
            with pytest.raises(DataFolderError) as raised:
                purge_folder(folder, 1e12)
        finally:
            os.seteuid(user)
            folder.chmod(0o755)
    for sentence in (*said, str(raised.value)):
        assert "has to be allowed to read and write the folder" in sentence
        assert "copy" not in sentence


@pytest.fixture
def steps() -> Iterator[list[str]]:
    """The files that are opened, moved or removed from now on, and the commits; a test adds those itself."""
    events: list[str] = []
    recording = True

    def record(event: str, arguments: tuple[object, ...]) -> None:
        if recording and event in ("open", "os.rename", "os.remove") and ".sqlite" not in str(arguments[0]):
            events.append(f"{event} {arguments[0]}")

    sys.addaudithook(record)  # it cannot be taken back
    yield events
    recording = False


def test_file_comes_before_its_row_and_goes_after_it(
    store: Store, tmp_path: Path, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each step is durable before the next one; at any moment, no row lacks its file."""
    transaction = store.database.transaction

    @contextmanager
    def recorded() -> Iterator[sqlite3.Connection]:
        with transaction() as db:
            yield db
        steps.append(f"commit of {store.database.rows('SELECT count(*) FROM measurements')[0][0]} rows")

    fsync = os.fsync

    def record_fsync(descriptor: int) -> None:
        steps.append(f"fsync {Path(f'/proc/self/fd/{descriptor}').readlink()}")
        fsync(descriptor)

    incoming = Incoming(store.blobs.temporary)
    incoming.write(b"content")
    monkeypatch.setattr(os, "fsync", record_fsync)
    monkeypatch.setattr(store.database, "transaction", recorded)
    steps.clear()
    incoming.close()
    store.add_measurement(LOCAL, incoming)
    path = store.blobs.path(incoming.sha256)
    folders = (path.parents[1], path.parent)
    assert [step for step in steps if not step.startswith("open")] == [
        f"fsync {incoming.path}",
        f"fsync {folders[0]}",
        f"os.rename {incoming.path}",
        f"fsync {folders[1]}",
        "commit of 1 rows",
    ]
    steps.clear()
    table = tmp_path / "table"
    rows = [f"{light},{seen},1" for light in (0, 40) for seen in range(-75, 76, 5)]
    table.write_text("\n".join(["theta_in,theta_out,value", *rows]))
    conversion_step(table, TableOptions(), lambda _: None)  # An upload that is converted is written once more.
    assert f"fsync {table}" in steps
    steps.clear()
    assert store.remove_measurement("", incoming.sha256)
    assert steps == ["commit of 0 rows", f"os.remove {path}", "commit of 0 rows"]


def test_deletion_that_cannot_be_committed_keeps_the_file(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    transaction = store.database.transaction

    @contextmanager
    def broken_off() -> Iterator[sqlite3.Connection]:
        with transaction() as db:
            yield db
            raise sqlite3.OperationalError("database or disk is full")

    sha256 = add(store, b"content")
    with monkeypatch.context() as full:
        full.setattr(store.database, "transaction", broken_off)
        with pytest.raises(sqlite3.OperationalError, match="full"):
            store.remove_measurement("", sha256)
    assert store.measurement_file("", sha256)[1].read_bytes() == b"content"
    assert store.remove_measurement("", sha256)
    assert not store.blobs.path(sha256).exists()


def test_full_disk_has_the_space_of_a_removed_file_at_the_commit(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    sha256 = add(store)
    with store.database.transaction() as db:
        assert remove_rows(db, store.blobs, db.execute("SELECT rowid, sha256 FROM measurements").fetchall()) == [sha256]
        assert not store.blobs.path(sha256).exists()


def test_measurement_is_deleted_also_where_its_file_cannot_be(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    sha256 = add(store, b"content")
    store.blobs.path(sha256).unlink()
    store.blobs.path(sha256).mkdir()  # what cannot be removed as a file, by nobody
    assert store.remove_measurement("", sha256)
    assert store.measurements("", 9, None) == []
    assert f"the file of the deleted measurement {sha256} stays" in caplog.text
