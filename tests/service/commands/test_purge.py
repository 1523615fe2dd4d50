"""Retention: what is old goes, beside a running server, and nothing else."""

import json
import sqlite3
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest

from dsbrdf.data.merl_validation import FILE_SIZE
from service.commands import purge
from service.storage.blobs import Blobs
from service.storage.database import FILE_NAME
from service.storage.schema import Caller
from service.storage.store import Store
from tests.support.commands import run_main
from tests.support.merl_files import with_value
from tests.support.processes import wait_until
from tests.support.server import ENDLESS, QUICK, Server
from tests.support.stores import add


def purged(folder: Path, *words: str) -> dict[str, Any]:
    done = run_main(purge.main, "--data-dir", str(folder), "--json", *words)
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    return document


def test_old_fits_and_measurements_are_removed_beside_a_running_server(
    own_server: Callable[..., Server], data: bytes
) -> None:
    server = own_server(workers="1")
    folder = server.data_dir
    old, fresh, unused, busy, kept = (
        str(server.http.post("/v1/measurements", content=content).json()["sha256"])
        for content in (with_value(data, 0.5 + index) for index in range(5))
    )
    old_fit, fresh_fit, kept_fit = (server.submit(sha256, **QUICK).json()["id"] for sha256 in (old, fresh, kept))
    busy_fit = server.submit(busy, prefer="respond-async", **ENDLESS).json()["id"]
    with closing(sqlite3.connect(folder / FILE_NAME, timeout=30)) as db, db:
        seconds = 40 * 86_400
        db.execute("UPDATE measurements SET created = created - ? WHERE sha256 != ?", (seconds, fresh))
        times = "created = created - :s, finished = finished - :s"
        db.execute(
            f"UPDATE fits SET {times} WHERE id IN (:old, :busy)", {"s": seconds, "old": old_fit, "busy": busy_fit}
        )
    values = f"/v1/fits/{old_fit}/brdf?theta_half_deg=1&theta_diff_deg=1"
    assert server.http.get(values).status_code == 200  # and so its model is in memory

    expected = {"fits": 1, "measurements": 2, "bytes": 2 * FILE_SIZE}
    assert purged(folder, "--older-than", "30d", "--dry-run") == {**expected, "dry_run": True}
    assert server.http.get(values).status_code == 200
    assert purged(folder, "--older-than", "30d") == {**expected, "dry_run": False}

    wait_until(lambda: server.http.get(values).status_code == 404)
    assert server.http.get(f"/v1/fits/{old_fit}").status_code == 404
    for sha256, there in ((old, False), (unused, False), (fresh, True), (busy, True), (kept, True)):
        assert server.http.head(f"/v1/measurements/{sha256}").status_code == (200 if there else 404)
        assert Blobs(folder).path(sha256).exists() == there
    for fit in (fresh_fit, kept_fit):
        assert server.http.get(f"/v1/fits/{fit}/brdf?theta_half_deg=1&theta_diff_deg=1").status_code == 200
    assert server.http.delete(f"/v1/fits/{busy_fit}").json()["status"] == "cancelled"  # and so it was there
    assert purged(folder, "--older-than", "30d") == {"fits": 0, "measurements": 0, "bytes": 0, "dry_run": False}


def test_file_is_removed_with_its_last_row(tmp_path: Path) -> None:
    with closing(Store(tmp_path)) as store:
        path = store.blobs.path(add(store, b"content"))
        add(store, b"content", Caller("other"))
        with store.database.transaction() as db:
            db.execute("UPDATE measurements SET created = 0 WHERE owner = 'other'")
        told = run_main(purge.main, "--data-dir", str(tmp_path), "--older-than", "1d", "--dry-run").stdout
        assert told == "0 fits and 1 measurements would be removed, 0.0 MB of files\n"
        expected = {"fits": 0, "measurements": 1, "bytes": 0}
        assert purged(tmp_path, "--older-than", "1d", "--dry-run") == {**expected, "dry_run": True}
        assert purged(tmp_path, "--older-than", "1d") == {**expected, "dry_run": False}
        assert path.exists()
        assert purged(tmp_path, "--older-than", "0s")["bytes"] == len(b"content")
        assert not path.exists()


def test_concurrent_uploads_of_purged_files_stay_consistent(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server(fits=False)
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
        wait_until(lambda: bool(purged(server.data_dir, "--older-than", "0s")) and statuses.count(201) >= 3)
    finally:
        done.set()
        for thread in threads:
            thread.join()
    assert set(statuses) <= {200, 201}
    stored = server.http.get("/v1/measurements").json()["items"]
    assert [path.stem for path in server.files()] == [row["sha256"] for row in stored]


@pytest.mark.parametrize("age", ["30", "d", "-1d", "1.5d", "30 d", "1y", "\u0663d", ""])
def test_invalid_age_is_refused_in_one_sentence(tmp_path: Path, age: str) -> None:
    refused = run_main(purge.main, "--data-dir", str(tmp_path), f"--older-than={age}")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "30d" in refused.stderr
    assert "--older-than" in refused.stderr
