"""``dsbrdf doctor`` finds what is wrong, and says nothing is where nothing is."""

import json
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from service.commands import doctor
from service.commands.doctor import CHECKS
from service.errors import CheckFailedError
from service.storage.database import FILE_NAME, read_only
from service.storage.schema import VERSION
from tests.support.commands import run_main
from tests.support.server import QUICK, Server


def examine(folder: Path, **environment: str) -> tuple[int, dict[str, dict[str, Any]]]:
    """Exit code and findings by name."""
    done = run_main(doctor.main, "--data-dir", str(folder), "--json", **environment)
    assert done.stdout, done.stderr
    return done.returncode, {item["check"]: item for item in json.loads(done.stdout)["items"]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> Iterator[Path]:
    """A data folder that no server has open, with a measurement and a fit of it."""
    with Server.running(tmp_path_factory.mktemp("doctor") / "data") as server:
        assert server.http.post("/v1/fits", params=QUICK, content=data).json()["status"] == "succeeded"
        server.stop()
        yield server.data_dir


def found(folder: Path, name: str) -> str:
    """What one check finds; it raises what is wrong."""
    return CHECKS[name](folder)


def fault(folder: Path, name: str) -> str:
    with pytest.raises(CheckFailedError) as wrong:
        found(folder, name)
    return str(wrong.value)


def wrong(findings: dict[str, dict[str, Any]]) -> dict[str, str]:
    return {name: item["detail"] for name, item in findings.items() if not item["fine"]}


def test_healthy_installation_passes_beside_a_running_server(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server(fits=False)
    server.http.post("/v1/measurements", content=data)
    code, findings = examine(server.data_dir)
    assert (code, wrong(findings)) == (0, {})
    assert set(findings) == {"database", "measurements", "lost files"}
    assert findings["measurements"]["detail"].startswith("1 ")
    assert server.http.get("/health/ready").status_code == 200


def test_text_output_has_one_line_per_check(folder: Path) -> None:
    done = run_main(doctor.main, "--data-dir", str(folder))
    assert done.returncode == 0
    assert [line.split(":")[0].split(maxsplit=1) for line in done.stdout.splitlines()] == [
        ["ok", "database"],
        ["ok", "measurements"],
        ["ok", "lost files"],
    ]


def test_missing_folder_is_refused_and_not_created(tmp_path: Path) -> None:
    done = run_main(doctor.main, "--data-dir", str(tmp_path / "none"))
    assert done.returncode == 2
    assert "is no data folder" in done.stderr
    assert not (tmp_path / "none").exists()


def test_damaged_database_ends_with_exit_code_1(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_bytes(b"no database, although it is as long as one could be" * 100)
    code, findings = examine(tmp_path)
    assert code == 1
    assert "not a database" in wrong(findings)["database"]


def test_damaged_and_missing_files_are_found(folder: Path) -> None:
    assert found(folder, "measurements").startswith("1 ")
    (blob,) = (folder / "blobs").glob("*/*.binary")
    content = blob.read_bytes()
    try:
        blob.write_bytes(content[:-1] + b"\1")
        assert blob.stem in fault(folder, "measurements")
        blob.unlink()
        assert "No such file" in fault(folder, "measurements")
    finally:
        blob.write_bytes(content)
    assert found(folder, "measurements").startswith("1 ")


def test_newer_or_corrupt_database_is_found(folder: Path, tmp_path: Path) -> None:
    assert "intact" in found(folder, "database")
    with pytest.raises(sqlite3.OperationalError, match="readonly"):
        read_only(folder, "DELETE FROM fits")
    name = tmp_path / FILE_NAME
    name.write_bytes((folder / FILE_NAME).read_bytes())
    with closing(sqlite3.connect(name)) as db, db:
        db.execute("PRAGMA user_version = 999")
    assert "another release" in fault(tmp_path, "database")
    with closing(sqlite3.connect(name)) as db, db:
        db.execute("PRAGMA journal_mode = DELETE")
        db.execute(f"PRAGMA user_version = {VERSION}")
        (page,) = db.execute("SELECT rootpage FROM sqlite_master WHERE name = 'fits_by_status'").fetchone()
        (size,) = db.execute("PRAGMA page_size").fetchone()
    with name.open("r+b") as file:
        file.seek((page - 1) * size)
        file.write(bytes([10, 0, 0, 0, 0, size >> 8, size & 255, 0]))  # an empty leaf of an index
    assert "fits_by_status" in fault(tmp_path, "database")
