"""``dsbrdf keys``, ``doctor`` and ``purge``, beside a running server."""

import json
import re
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from dsbrdf.cli.main import main
from dsbrdf.data import FILE_SIZE
from dsbrdf_service.admin.commands import doctor, purge
from dsbrdf_service.storage.database import FILE_NAME, Database, read_only
from dsbrdf_service.storage.files import Blobs
from dsbrdf_service.storage.keys import add_key, revoke_key
from dsbrdf_service.storage.store import Store
from tests.support.command_line import run_main, start_in_vain
from tests.support.merl_files import with_value
from tests.support.processes import wait_until
from tests.support.server import ENDLESS, LOCAL, QUICK, Guarded, Server, StartServer, add, assert_problem, keys_command
from tests.support.soak import SOAK

pytestmark = pytest.mark.slow


def test_keys_are_added_listed_and_revoked_beside_a_running_server(guarded: Guarded) -> None:
    server = guarded.server
    there = ("--data-dir", str(server.data_dir))
    words = ["add", "carol's laptop", *there, "--requests-per-second", "7", "--stored-mb", "80"]
    added = run_main(main, "keys", *words)
    key = added.stdout.removesuffix("\n")
    assert re.fullmatch(r"dsbrdf_[0-9a-f]{12}_[\w-]{43}", key)
    key_id = key.split("_")[1]
    assert key_id in added.stderr
    assert key not in added.stderr
    header = {"Authorization": f"Bearer {key}"}
    wait_until(lambda: server.http.get("/v1/fits", headers=header).status_code == 200)

    document = listed(server)[key_id]
    assert abs(datetime.fromisoformat(document.pop("created")) - datetime.now(UTC)) < timedelta(minutes=5)
    limits = {"requests_per_second": 7.0, "stored_mb": 80, "queued_fits": None, "metrics": False}
    assert document == {"id": key_id, "name": "carol's laptop", "revoked": None} | limits
    assert type(document["metrics"]) is bool
    assert re.search(r" 7 +80 +default  carol's laptop\n", keys_command("list", *there).stdout)

    before = listed(server)
    for wrong in ("*", "%", "' OR 1=1 --", "", key_id[:-1], f"{key_id} ", key):
        refused = keys_command("revoke", wrong, *there)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
        assert key not in refused.stderr
    assert listed(server) == before
    assert keys_command("revoke", key_id, *there).returncode == 0
    seconds = wait_until(lambda: server.http.get("/v1/fits", headers=header).status_code == 401)
    assert not SOAK or seconds < 1.2
    first = listed(server)[key_id]["revoked"]
    assert first is not None
    assert keys_command("revoke", key_id, *there).returncode == 0
    assert listed(server)[key_id]["revoked"] == first


def listed(server: Server) -> dict[str, dict[str, Any]]:
    document = json.loads(keys_command("list", "--json", "--data-dir", str(server.data_dir)).stdout)
    return {item["id"]: item for item in document["items"]}


def test_service_on_a_public_address_requires_an_active_key(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    with closing(Database(folder)) as database:
        revoke_key(database, add_key(database, "x")[0])
    code, said = start_in_vain(tmp_path, "--host", "0.0.0.0", "--port", "0", "--data-dir", str(folder))
    assert (code, "dsbrdf keys add" in said) == (2, True)
    with closing(Database(folder)) as database:
        _, key = add_key(database, "y")
    with Server.running(folder, host="0.0.0.0") as server:
        assert_problem(server.http.get("/v1/fits"), 401, "unauthorized")
        assert server.http.get("/v1/fits", headers={"Authorization": f"Bearer {key}"}).status_code == 200


def purged(folder: Path, *words: str) -> dict[str, Any]:
    done = run_main(purge, "--data-dir", str(folder), "--json", *words)
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    return document


def test_old_fits_and_measurements_are_removed_beside_a_running_server(own_server: StartServer, data: bytes) -> None:
    server = own_server(workers="1")
    folder = server.data_dir
    contents = [with_value(data, 0.5 + index) for index in range(5)]
    uploads = [server.http.post("/v1/measurements", content=content).json() for content in contents]
    old, fresh, unused, busy, kept = (str(upload["sha256"]) for upload in uploads)
    old_fit, fresh_fit, kept_fit = (server.submit(sha256, **QUICK).json()["id"] for sha256 in (old, fresh, kept))
    busy_fit = server.submit(busy, prefer="respond-async", **ENDLESS).json()["id"]
    with closing(sqlite3.connect(folder / FILE_NAME, timeout=30)) as db, db:
        seconds = 40 * 86_400
        db.execute("UPDATE measurements SET created = created - ? WHERE sha256 != ?", (seconds, fresh))
        times = "created = created - :s, finished = finished - :s"
        values = {"s": seconds, "old": old_fit, "busy": busy_fit}
        db.execute(f"UPDATE fits SET {times} WHERE id IN (:old, :busy)", values)
    address = f"/v1/fits/{old_fit}/brdf?theta_half_deg=1&theta_diff_deg=1"
    assert server.http.get(address).status_code == 200  # and so its model is in memory

    expected = {"fits": 1, "measurements": 2, "files_without_rows": 0, "bytes": 2 * FILE_SIZE}
    assert purged(folder, "--older-than", "30d") == expected

    wait_until(lambda: server.http.get(address).status_code == 404)
    assert server.http.get(f"/v1/fits/{old_fit}").status_code == 404
    for sha256, there in ((old, False), (unused, False), (fresh, True), (busy, True), (kept, True)):
        assert server.http.head(f"/v1/measurements/{sha256}").status_code == (200 if there else 404)
        assert Blobs(folder).path(sha256).exists() == there
    for fit in (fresh_fit, kept_fit):
        assert server.http.get(f"/v1/fits/{fit}/brdf?theta_half_deg=1&theta_diff_deg=1").status_code == 200
    assert server.http.delete(f"/v1/fits/{busy_fit}").json()["status"] == "cancelled"  # and so it was there
    told = run_main(purge, "--data-dir", str(folder), "--older-than", "30d").stdout
    assert told == "0 fits, 0 measurements and 0 files without rows removed, 0.0 MB of files\n"


def test_concurrent_uploads_of_purged_files_stay_consistent(own_server: StartServer, data: bytes) -> None:
    server = own_server()
    done = threading.Event()
    statuses: list[int] = []

    def upload() -> None:
        with httpx.Client(base_url=server.http.base_url, timeout=60) as client:
            while not done.is_set():
                statuses.append(client.post("/v1/measurements", content=data).status_code)

    threads = [threading.Thread(target=upload) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        wait_until(lambda: bool(purged(server.data_dir, "--older-than", "0s")) and statuses.count(201) >= 2)
    finally:
        done.set()
        for thread in threads:
            thread.join()
    assert set(statuses) <= {200, 201}
    stored = server.http.get("/v1/measurements").json()["items"]
    assert [path.stem for path in server.files()] == [row["sha256"] for row in stored]


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    with closing(Store(tmp_path)) as store:
        store.add_fit(LOCAL, add(store), {}, 10)
        yield tmp_path


def examine(folder: Path) -> dict[str, str]:
    """Return what each check finds; what is wrong begins with a mark."""
    done = run_main(doctor, "--data-dir", str(folder), "--json")
    items = json.loads(done.stdout)["items"]
    assert done.returncode == (0 if all(item["fine"] for item in items) else 1)
    return {item["check"]: ("" if item["fine"] else "WRONG ") + item["detail"] for item in items}


def test_healthy_folder_of_a_running_server_passes_and_is_not_changed(folder: Path) -> None:
    done = run_main(doctor, "--data-dir", str(folder))
    assert done.returncode == 0
    assert done.stdout.splitlines() == [
        "ok     database:       intact, 1 fits",
        "ok     measurements:   1 files are what their rows say",
        "ok     files:          1 files have rows",
    ]
    with pytest.raises(sqlite3.OperationalError, match="readonly"):
        read_only(folder, "DELETE FROM fits")


def test_damaged_and_missing_files_are_found(folder: Path) -> None:
    (blob,) = (folder / "blobs").glob("*/*.binary")
    blob.write_bytes(b"consent")
    found = examine(folder)["measurements"]
    assert found.startswith(f"WRONG 1 of 1 files are damaged or missing, first {blob.stem} (its sha256 is another one)")
    blob.unlink()
    assert "No such file" in examine(folder)["measurements"]


def test_file_that_is_deleted_while_it_is_read_is_no_damage(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    damage = Blobs.damage

    def deleted(blobs: Blobs, sha256: str) -> str | None:
        with closing(sqlite3.connect(folder / FILE_NAME)) as db, db:
            db.execute("DELETE FROM measurements")
        blobs.path(sha256).unlink()
        return damage(blobs, sha256)

    monkeypatch.setattr(Blobs, "damage", deleted)
    assert examine(folder)["measurements"] == "0 files are what their rows say"


def test_what_is_no_database_of_this_release_is_found(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    with closing(sqlite3.connect(folder / FILE_NAME)) as db, db:
        db.execute("PRAGMA user_version = 999")
    assert "WRONG another release" in examine(folder)["database"]
    other = tmp_path_factory.mktemp("other")
    (other / FILE_NAME).write_bytes(b"no database, although it is as long as one could be" * 100)
    assert "not a database" in examine(other)["database"]
    refused = keys_command("list", "--data-dir", str(other))
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "cannot be opened" in refused.stderr
