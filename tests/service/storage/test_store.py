"""The store on its own: what a fit may become, what owners share, and what a fault of a row, file or folder leaves."""

import asyncio
import errno
import os
import shutil
import sqlite3
import stat
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

import dsbrdf
from dsbrdf_service import errors
from dsbrdf_service.compute.computations import ModelCache
from dsbrdf_service.errors import DataFolderError, MeasurementDamagedError, ProblemError
from dsbrdf_service.storage.database import FILE_NAME, Database
from dsbrdf_service.storage.health import check_rows, check_space
from dsbrdf_service.storage.maintenance import check_database, check_measurements, purge_folder, remove_files
from dsbrdf_service.storage.schema import ROW_DAMAGED, ROW_SIZE, UNFINISHED_SIZE, Caller, FitKey
from dsbrdf_service.storage.store import Store, fit_identity
from dsbrdf_service.wire import to_wire
from tests.support.processes import short_folder
from tests.support.server import LOCAL, add, receive

OPTIONS = to_wire(dsbrdf.FitOptions())


def test_finished_fit_cannot_change(store: Store) -> None:
    sha256 = add(store)
    arguments = (sha256, OPTIONS, 10)
    key = FitKey("", fit_identity(sha256, OPTIONS))
    with pytest.raises(errors.MeasurementNotFoundError):
        store.add_fit(LOCAL, "other", OPTIONS, 10)
    row, new = store.add_fit(LOCAL, *arguments)
    assert (row.status, new) == ("accepted", True)
    assert store.complete_fit(key, "document", {}) is None  # it does not run
    assert store.start_fit(key) is not None
    assert not store.remove_fit(key)
    assert store.complete_fit(key, "document", {"male": 0.5}) is not None
    store.fail_fit(key, {})
    for refused in (store.cancel_fit(key), store.start_fit(key)):
        assert refused is None
    row, new = store.add_fit(LOCAL, *arguments)
    assert (row.status, new, row.metrics, store.result(key)) == ("succeeded", False, {"male": 0.5}, b"document")
    with pytest.raises(ProblemError, match="stored without a thumbnail"):
        store.thumbnail(key)
    assert store.remove_fit(key)
    with pytest.raises(errors.FitNotFoundError):
        store.fit(key)


@pytest.mark.parametrize(("origin", "repeats"), [("input", False), ("compute", True), ("system", True)])
def test_failed_fit_runs_again_unless_its_input_is_at_fault(store: Store, origin: str, repeats: bool) -> None:
    arguments = (add(store), OPTIONS, 10)
    key = store.add_fit(LOCAL, *arguments, "mine")[0].key
    store.start_fit(key)
    store.fail_fit(key, {"origin": origin, "type": "T", "message": "M"})
    row, is_new = store.add_fit(LOCAL, *arguments)
    assert (row.name, is_new) == ("mine", repeats)


def test_owners_share_only_the_file_of_a_measurement(store: Store) -> None:
    owners = Caller("a"), Caller("b")
    sha256, _ = (add(store, b"x", owner) for owner in owners)
    fits = [store.add_fit(owner, sha256, {}, 10)[0] for owner in owners]
    # Links to further pages hold these numbers, and do not tell what others have.
    assert [row.seq for row in fits] == [row.seq for row in store.measurements("b", 9, None)] * 2 == [1, 1]
    of_a, of_b = (row.key for row in fits)
    assert [store.fits_of(owner.owner, sha256, 9) for owner in owners] == [[of_a.id], [of_b.id]]
    store.start_fit(of_b)
    store.complete_fit(of_b, "of b", {})
    assert store.fit(of_a).status == "accepted"
    with pytest.raises(ProblemError, match="wait until it has succeeded"):
        store.result(of_a)
    assert store.remove_measurement("b", sha256)  # a's fit of it is unfinished, b's is not
    assert store.blobs.path(sha256).exists()
    assert not store.remove_measurement("b", sha256)
    store.cancel_fit(of_a)
    assert store.remove_measurement("a", sha256)
    assert not store.blobs.path(sha256).exists()
    assert store.result(of_b) == b"of b"


@pytest.mark.parametrize("damage", ["result = 'docunent'", "checksum = NULL"])
def test_damaged_result_is_not_returned(store: Store, damage: str) -> None:
    key = store.add_fit(LOCAL, add(store), OPTIONS, 10)[0].key
    store.start_fit(key)
    store.complete_fit(key, "document", {"male": 0.5})
    with store.database.transaction() as db:
        db.execute(f"UPDATE fits SET {damage}")
    with pytest.raises(ProblemError, match="result of the fit is damaged; delete the fit and fit the measurement"):
        asyncio.run(ModelCache(store, 1).get(key))


def test_database_with_other_tables_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    Store(tmp_path).close()
    file = tmp_path / FILE_NAME
    database = sqlite3.connect(file, isolation_level=None)
    database.execute("ALTER TABLE keys DROP COLUMN metrics")
    database.execute("PRAGMA user_version = 1")  # as an older release has numbered it
    database.close()
    before = file.read_bytes()
    for open_folder in (Store, partial(Database, exclusive=False)):
        with pytest.raises(DataFolderError, match=r"made by another release.* serve it with that release, or give"):
            open_folder(tmp_path)
    assert file.read_bytes() == before


def test_transactions_are_synced_to_the_disk_before_they_end(store: Store) -> None:
    with store.database.transaction() as db:
        assert db.execute("PRAGMA synchronous").fetchone() == (2,)  # FULL: the log is synced at every commit
        assert db.execute("PRAGMA journal_mode").fetchone() == ("wal",)


@pytest.mark.parametrize("suffix", ["", "-wal", "-shm"])
@pytest.mark.parametrize("replaced", [True, False])
def test_lost_database_is_not_written(store: Store, tmp_path: Path, suffix: str, replaced: bool) -> None:
    path = tmp_path / f"{FILE_NAME}{suffix}"
    shutil.copy(path, tmp_path / "copy")
    lost = pytest.raises(errors.DatabaseLostError, match=f"{path.name} has been removed or replaced")
    with lost, store.database.transaction():
        path.unlink()  # what is committed now is lost at the next crash
    if replaced:
        (tmp_path / "copy").rename(path)
    with pytest.raises(errors.DatabaseLostError), store.database.transaction():
        pytest.fail("the transaction began")


def test_cancelled_fits_and_results_count_as_stored_bytes(store: Store) -> None:
    sha256 = add(store, b"12345", Caller("a"))

    def submit(mask: int, most: int) -> FitKey:
        return store.add_fit(Caller("a", stored_bytes=most), sha256, {"mask": mask}, 10)[0].key

    first, stored = submit(0, 5 + UNFINISHED_SIZE), 5 + ROW_SIZE + len("é".encode()) + len(b"PNG") + UNFINISHED_SIZE
    with pytest.raises(ProblemError, match=r"has stored 0\.1 of 0\.2 MB and the fit may take 0\.1 MB"):
        submit(1, 4 + 2 * UNFINISHED_SIZE)  # The result of the first fit has its room.
    store.start_fit(first)
    store.complete_fit(first, "é", {}, b"PNG")
    with pytest.raises(ProblemError):
        submit(1, stored - 1)
    store.cancel_fit(submit(1, stored))
    with pytest.raises(ProblemError):
        submit(2, stored + ROW_SIZE - 1)
    assert store.remove_fit(first)
    submit(2, stored)  # there is room again


def test_a_caller_stores_and_queues_no_more_than_is_allowed(store: Store) -> None:
    allowed = 1000 + UNFINISHED_SIZE
    caller, other = Caller("a", stored_bytes=allowed, queued_fits=2), Caller("b", queued_fits=2)
    sha256 = add(store, b"x" * 1000, caller)
    with pytest.raises(ProblemError, match=r"and the measurement has 0\.1 MB; delete what is not needed"):
        add(store, b"y" * (UNFINISHED_SIZE + 1), caller)
    assert [row.sha256 for row in store.measurements("a", 9, None)] == [sha256]
    assert not store.add_measurement(caller, receive(store, b"x" * 1000))[1]  # nothing more is stored
    add(store, b"x" * 1000, other)
    with ThreadPoolExecutor(6) as pool:
        asked = [pool.submit(store.add_fit, other, sha256, {"mask": number}, 10) for number in range(6)]
    accepted = [one.result()[0] for one in asked if one.exception() is None]
    refused = [str(one.exception()) for one in asked if one.exception() is not None]
    assert refused == ["2 fits of this key are unfinished, which is the limit; try again when one has ended."] * 4
    assert store.add_fit(other, sha256, accepted[0].options, 10) == (accepted[0], False)
    store.cancel_fit(accepted[0].key)
    assert store.add_fit(other, sha256, {"mask": 9}, 10)[1]
    with pytest.raises(ProblemError, match="2 fits are waiting, which is the limit"):
        store.add_fit(caller, sha256, {}, 2)


def change(folder: Path, *statements: str) -> None:
    with closing(sqlite3.connect(folder / FILE_NAME, isolation_level=None)) as db:
        db.execute("PRAGMA ignore_check_constraints = ON")
        for statement in statements:
            db.execute(statement)


@pytest.mark.parametrize(
    ("damage", "status"),
    [
        ("options = '{\"n_lobes\": 1'", "failed"),
        ("options = '[]'", "failed"),
        ("error = '{}'", "failed"),
        ("metrics = CAST(x'7bff' AS TEXT)", "failed"),
        ("status = 'sucxeeded'", "failed"),
        ("created = 1e300", "accepted"),
        ("name = CAST(x'41ff' AS TEXT)", "accepted"),
    ],
)
def test_damaged_row_is_listed_examined_and_deleted(store: Store, tmp_path: Path, damage: str, status: str) -> None:
    sha256 = add(store)
    key, other = (store.add_fit(LOCAL, sha256, {"n_lobes": number}, 10)[0].key for number in (1, 2))
    assert check_database(tmp_path) == (True, "intact, 2 fits")
    change(tmp_path, f"UPDATE fits SET {damage} WHERE id = '{key.id}'")
    listed = {row.key: row for row in store.fits("", 10, None)}
    assert listed.keys() == {key, other}
    assert (listed[key].status, listed[other].status) == (status, "accepted")
    assert status == "accepted" or (listed[key].error or {})["type"] == ROW_DAMAGED
    is_fine, said = check_database(tmp_path)
    assert (is_fine, f"1 rows are damaged, first the fit {key.id}" in said) == (False, True)
    store.cancel_fit(key)
    assert store.remove_fit(key)
    assert check_database(tmp_path) == (True, "intact, 1 fits")


def test_damaged_result_and_measurement_are_examined(store: Store, tmp_path: Path) -> None:
    sha256 = add(store)
    key = store.add_fit(LOCAL, sha256, {}, 10)[0].key
    store.start_fit(key)
    store.complete_fit(key, "document", {})
    for damage, named in (("fits SET result = 'documenX'", key.id), ("measurements SET created = -1.0", sha256)):
        change(tmp_path, f"UPDATE {damage}")
        assert named in check_database(tmp_path)[1]
        change(tmp_path, "UPDATE fits SET result = 'document'")
    assert [row.created for row in store.measurements("", 10, None)] == [0.0]


@pytest.mark.parametrize(
    "harm",
    ["DROP TABLE keys", "CREATE TRIGGER t BEFORE INSERT ON measurements BEGIN SELECT RAISE(ABORT, 'no'); END"],
)
def test_check_tries_what_an_upload_needs_and_leaves_nothing(store: Store, tmp_path: Path, harm: str) -> None:
    check_rows(store.database)
    store.blobs.check()
    assert (store.measurements("nobody", 1, None), store.fits("nobody", 1, None)) == ([], [])
    assert [path for part in ("blobs", "tmp") for path in (tmp_path / part).iterdir()] == []
    change(tmp_path, harm)
    with pytest.raises(sqlite3.Error):
        check_rows(store.database)


def test_folder_that_is_away_is_no_damage_of_its_files(store: Store, tmp_path: Path) -> None:
    sha256, missing = add(store), add(store, b"missing")
    store.blobs.path(missing).unlink()
    with pytest.raises(MeasurementDamagedError, match="No such file"):
        store.sound_file(missing)
    blobs, away = tmp_path / "blobs", tmp_path / "away"
    for is_replaced in (False, True):  # Where a volume was mounted, an empty folder can remain.
        blobs.rename(away)
        if is_replaced:
            blobs.mkdir()
        for name in (sha256, missing):
            with pytest.raises(FileNotFoundError):
                store.sound_file(name)
        shutil.rmtree(blobs, ignore_errors=True)
        away.rename(blobs)
        assert store.sound_file(sha256).read_bytes() == b"content"


def test_folders_need_no_fsync_but_files_do(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    fsync, are_folders = os.fsync, True

    def refuse(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode) is are_folders:
            raise OSError(errno.EINVAL, "Invalid argument")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", refuse)
    check_rows(store.database)
    path = store.sound_file(add(store))
    assert path.read_bytes() == b"content"
    assert path.parent not in [opened.resolve() for opened in Path("/proc/self/fd").iterdir()]  # It is closed again.
    are_folders = False
    with pytest.raises(OSError, match="Invalid argument"):
        store.blobs.check()


def test_full_disk_keeps_a_file_that_another_key_has(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    sha256 = add(store)
    add(store, caller=Caller("other"))
    assert store.remove_measurement("", sha256)
    assert store.sound_file(sha256).read_bytes() == b"content"
    assert store.remove_measurement("other", sha256)
    assert not store.blobs.path(sha256).exists()


def test_measurement_that_is_deleted_while_its_file_is_read_is_not_found(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    sha256 = add(store)
    monkeypatch.setattr(store.blobs, "damage", lambda _: str(store.remove_measurement("", sha256)))
    with pytest.raises(errors.MeasurementNotFoundError):
        store.measurement_file("", sha256)


def test_file_whose_bytes_were_uploaded_again_meanwhile_stays(store: Store) -> None:
    sha256 = add(store)  # as between the deletion of an earlier row and that of its file
    assert remove_files(store.database, store.blobs, [sha256]) == []
    assert store.sound_file(sha256).read_bytes() == b"content"


def test_fit_of_another_owner_does_not_keep_an_old_measurement(store: Store, tmp_path: Path) -> None:
    sha256, other = add(store), Caller("other")
    add(store, caller=other)
    store.add_fit(other, sha256, OPTIONS, 10)
    assert purge_folder(tmp_path, 1e12) == {"fits": 0, "measurements": 1, "files_without_rows": 0, "bytes": 0}
    assert not store.measurements("", 9, None)
    assert store.measurement_file("other", sha256)[1].read_bytes() == b"content"


def test_space_is_enough_if_it_is_what_the_settings_ask_for(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=256 << 20))
    check_space(store.folder, 256)
    with pytest.raises(RuntimeError, match=r"^only 256 MB are free; the service needs 257 MB$"):
        check_space(store.folder, 257)


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Let nothing be written in a folder, also by the superuser, who is somebody else for this time."""
    user = os.geteuid()
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        if not user:
            os.seteuid(65534)
        yield
    finally:
        os.seteuid(user)
        folder.chmod(0o755)
        for path in folder.rglob("*"):
            path.chmod(0o755)


def test_snapshot_where_nothing_can_be_written_is_examined() -> None:
    with short_folder() as name:
        folder, snapshot = Path(name) / "data", Path(name) / "snapshot"
        Path(name).chmod(0o755)
        with closing(Store(folder)) as store:
            add(store)
            shutil.copytree(folder, snapshot, ignore=shutil.ignore_patterns("*-shm"))
        with read_only(folder):
            assert check_database(folder) == (True, "intact, 0 fits")
            assert check_measurements(folder) == (True, "1 files are what their rows say")
        with read_only(snapshot), pytest.raises(OSError, match="sqlite-wal has changes"):
            check_database(snapshot)
