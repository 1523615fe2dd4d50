"""``dsbrdf doctor`` finds what is wrong, and says nothing is where nothing is."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from service.commands import doctor
from service.storage.database import FILE_NAME, read_only
from service.storage.store import Store
from tests.support.commands import run_main
from tests.support.stores import LOCAL, add


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A data folder with a measurement and a fit of it, which a server has open."""
    with closing(Store(tmp_path)) as store:
        store.add_fit(LOCAL, add(store), {}, 10)
        yield tmp_path


def examine(folder: Path) -> dict[str, str]:
    """Return what each check finds; what is wrong begins with a mark."""
    done = run_main(doctor.main, "--data-dir", str(folder), "--json")
    items = json.loads(done.stdout)["items"]
    assert done.returncode == (0 if all(item["fine"] for item in items) else 1)
    return {item["check"]: ("" if item["fine"] else "WRONG ") + item["detail"] for item in items}


def test_healthy_folder_of_a_running_server_passes_and_is_not_changed(folder: Path) -> None:
    done = run_main(doctor.main, "--data-dir", str(folder))
    assert (done.returncode, done.stdout.splitlines()) == (
        0,
        [
            "ok     database:       intact, 1 fits",
            "ok     measurements:   1 files are what their rows say",
            "ok     lost files:     no file is set aside",
        ],
    )
    with pytest.raises(sqlite3.OperationalError, match="readonly"):
        read_only(folder, "DELETE FROM fits")


def test_a_reader_that_has_read_enough_is_no_fault_of_the_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def end(*_: object, **__: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("builtins.print", end)
    with pytest.raises(BrokenPipeError):  # for `dsbrdf`, which says nothing of it
        doctor.main(["--data-dir", str(folder)])


def test_no_database_is_found(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_bytes(b"no database, although it is as long as one could be" * 100)
    assert "not a database" in examine(tmp_path)["database"]


def test_damaged_and_missing_files_are_found(folder: Path) -> None:
    (blob,) = (folder / "blobs").glob("*/*.binary")
    blob.write_bytes(b"consent")
    found = examine(folder)["measurements"]
    assert found.startswith(f"WRONG 1 of 1 files are damaged or missing, first {blob.stem} (its sha256 is another one)")
    blob.unlink()
    assert "No such file" in examine(folder)["measurements"]


def test_database_of_another_release_is_found(folder: Path) -> None:
    with closing(sqlite3.connect(folder / FILE_NAME)) as db, db:
        db.execute("PRAGMA user_version = 999")
    assert "WRONG another release" in examine(folder)["database"]
