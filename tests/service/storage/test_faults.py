"""A fault of one row or file is that row's or file's; a fault of the folder passes, and readiness reports it."""

import errno
import os
import shutil
import sqlite3
import stat
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from dsbrdf_service.errors import MeasurementDamagedError
from dsbrdf_service.storage.database import FILE_NAME
from dsbrdf_service.storage.maintenance import check_database, check_measurements
from dsbrdf_service.storage.schema import ROW_DAMAGED, Caller
from dsbrdf_service.storage.store import Store
from tests.support.processes import short_folder
from tests.support.stores import LOCAL, add


def change(folder: Path, *statements: str) -> None:
    """Change the database as no service does."""
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
def test_damaged_row_is_listed_and_examined_and_can_be_deleted(
    store: Store, tmp_path: Path, damage: str, status: str
) -> None:
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
    store.check()
    store.blobs.check()
    assert (store.measurements("nobody", 1, None), store.fits("nobody", 1, None)) == ([], [])
    assert [path for part in ("blobs", "tmp") for path in (tmp_path / part).iterdir()] == []
    change(tmp_path, harm)
    with pytest.raises(sqlite3.Error):
        store.check()


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
    store.check()
    assert store.sound_file(add(store)).read_bytes() == b"content"
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


def test_space_is_enough_if_it_is_what_the_settings_ask_for(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=256 << 20))
    store.check_space(256)
    with pytest.raises(RuntimeError, match=r"^only 256 MB are free; the service needs 257 MB$"):
        store.check_space(257)


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
