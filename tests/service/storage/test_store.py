"""Parts of the service on their own: decoders, options, store, preferences."""

import shutil
from pathlib import Path

import pytest

import dsbrdf
from service.errors import DatabaseLostError, DataFolderInUseError, MeasurementNotFoundError
from service.storage.database import FILE_NAME
from service.storage.schema import Caller, FitKey
from service.storage.store import Store, fit_identity
from service.storage.uploads import Received
from service.wire.fit_options import to_wire

LOCAL = Caller()
OPTIONS = to_wire(dsbrdf.FitOptions())


def test_finished_fit_cannot_change(tmp_path: Path) -> None:
    store = Store(tmp_path)
    incoming = store.blobs.incoming()
    incoming.write(b"content")
    sha256 = incoming.close()
    store.add_measurement(LOCAL, Received(incoming, sha256, 1))
    arguments = (sha256, OPTIONS, 10)
    key = FitKey("", fit_identity(sha256, OPTIONS))
    with pytest.raises(MeasurementNotFoundError):
        store.add_fit(LOCAL, "other", OPTIONS, 10)
    row, new = store.add_fit(LOCAL, *arguments)
    assert (row.status, new) == ("accepted", True)
    assert store.complete_fit(key, "document", {}) is None  # it does not run
    assert store.start_fit(key) is not None
    assert store.start_fit(key) is None
    assert not store.remove_fit(key)
    assert store.complete_fit(key, "document", {"male": 0.5}) is not None
    for refused in (store.cancel_fit(key), store.fail_fit(key, {}), store.requeue_fit(key), store.start_fit(key)):
        assert refused is None
    row, new = store.add_fit(LOCAL, *arguments)
    assert (row.status, new, row.metrics, store.result(key)) == ("succeeded", False, {"male": 0.5}, "document")
    assert store.remove_fit(key)
    assert store.fit(key) is None
    store.close()


@pytest.mark.parametrize(("origin", "repeats"), [("input", False), ("compute", True), ("system", True)])
def test_failed_fit_runs_again_unless_its_input_is_at_fault(tmp_path: Path, origin: str, repeats: bool) -> None:
    store = Store(tmp_path)
    incoming = store.blobs.incoming()
    sha256 = incoming.close()
    store.add_measurement(LOCAL, Received(incoming, sha256, 1))
    arguments = (sha256, OPTIONS, 10)
    key = FitKey("", fit_identity(sha256, OPTIONS))
    store.add_fit(LOCAL, *arguments)
    store.start_fit(key)
    store.fail_fit(key, {"origin": origin, "type": "T", "message": "M"})
    assert store.add_fit(LOCAL, *arguments)[1] is repeats
    store.close()


def test_data_folder_is_opened_by_one_store_at_a_time(tmp_path: Path) -> None:
    first = Store(tmp_path)
    with pytest.raises(DataFolderInUseError, match="in use"):
        Store(tmp_path)
    first.close()
    Store(tmp_path).close()


def test_transactions_are_synced_to_the_disk_before_they_end(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.database.transaction() as db:
        assert db.execute("PRAGMA synchronous").fetchone() == (2,)  # FULL: the log is synced at every commit
        assert db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    store.close()


def test_measurement_without_file_accepts_it_again(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for expected_new in (True, False):
        incoming = store.blobs.incoming()
        incoming.write(b"content")
        sha256 = incoming.close()
        assert store.add_measurement(LOCAL, Received(incoming, sha256, 1))[1] is expected_new
        assert store.blobs.path(sha256).read_bytes() == b"content"
        store.blobs.path(sha256).unlink()
    store.close()


def test_transaction_that_fails_leaves_nothing(tmp_path: Path) -> None:
    store = Store(tmp_path)

    def insert_and_fail() -> None:
        with store.database.transaction() as db:
            db.execute("INSERT INTO keys (id, name, secret_sha256, created) VALUES ('1', 'a', '', 0)")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        insert_and_fail()
    assert store.database.rows("SELECT * FROM keys") == []
    store.close()
    reopened = Store(tmp_path)
    assert reopened.database.rows("SELECT * FROM keys") == []
    reopened.close()


def test_nothing_is_written_to_a_database_that_was_replaced(tmp_path: Path) -> None:
    store = Store(tmp_path)
    path = tmp_path / FILE_NAME
    shutil.copy(path, tmp_path / "copy")
    (tmp_path / "copy").replace(path)
    with pytest.raises(DatabaseLostError, match="removed or replaced"), store.database.transaction():
        pytest.fail("the transaction began")
    store.close()


def test_upload_that_cannot_be_placed_leaves_no_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)
    incoming = store.blobs.incoming()
    received = Received(incoming, incoming.close(), 1)

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store.blobs, "place", fail)
    with pytest.raises(OSError, match="No space"):
        store.add_measurement(LOCAL, received)
    assert store.measurements("", 9, None) == []
    store.close()
