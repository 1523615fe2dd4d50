"""Parts of the service on their own: decoders, options, store, preferences."""

from pathlib import Path

import pytest

import dsbrdf
from service.errors import DataFolderInUseError, MeasurementNotFoundError
from service.storage.schema import Caller, FitKey
from service.storage.store import Store
from service.wire.fit_options import to_wire

LOCAL = Caller()

FIT = FitKey("", "f")


def test_finished_fit_cannot_change(tmp_path: Path) -> None:
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
def test_failed_fit_runs_again_unless_its_input_is_at_fault(tmp_path: Path, origin: str, repeats: bool) -> None:
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


def test_data_folder_is_opened_by_one_store_at_a_time(tmp_path: Path) -> None:
    first = Store(tmp_path)
    with pytest.raises(DataFolderInUseError, match="in use"):
        Store(tmp_path)
    first.close()
    Store(tmp_path).close()


def test_measurement_without_file_accepts_it_again(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for expected_new in (True, False):
        incoming = store.blobs.incoming()
        incoming.write(b"content")
        sha256 = incoming.close()
        assert store.add_measurement(LOCAL, incoming, sha256, 1)[1] is expected_new
        assert store.blobs.path(sha256).read_bytes() == b"content"
        store.blobs.remove(sha256)
    store.close()
