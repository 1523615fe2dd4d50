"""The page on operations says what is so: its table of settings, its metrics, its backup."""

import re
import runpy
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from dsbrdf_service.admin.commands import doctor
from dsbrdf_service.settings import PREFIX, Settings
from tests.support.commands import run_main
from tests.support.server import QUICK, Server

pytestmark = pytest.mark.slow

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "operations.md").read_text()


def test_table_of_settings_is_up_to_date() -> None:
    with_table = runpy.run_path(str(DOCS / "_ext/settings_table.py"))["with_table"]
    assert with_table(PAGE) == PAGE, "run: python docs/_ext/settings_table.py"


def test_settings_that_are_mentioned_exist() -> None:
    mentioned = set(re.findall(rf"\b{PREFIX}[A-Z_]+", PAGE))
    assert mentioned == {PREFIX + name.upper() for name in Settings.model_fields}


def test_every_metric_is_explained(server: Server) -> None:
    exposed = set(
        re.findall(r"^# TYPE (dsbrdf_\w+) (?:counter|gauge|histogram)$", server.http.get("/metrics").text, re.M)
    )
    assert {name for name in exposed if not name.endswith("_created")} == set(
        re.findall(r"^\| `(dsbrdf_\w+)", PAGE, re.M)
    )


def test_backup_of_a_running_service_can_be_restored(
    own_server: Callable[..., Server], data: bytes, tmp_path: Path
) -> None:
    server, copy = own_server(), tmp_path / "copy"
    fit = server.http.post("/v1/fits", params={**QUICK, "name": "nickel"}, content=data).json()
    copy.mkdir()
    (command,) = re.findall(r'"(VACUUM INTO .*)"', PAGE)
    with closing(sqlite3.connect(server.data_dir / "dsbrdf.sqlite")) as database:
        database.execute(command.replace("/backup", str(copy)))
    shutil.copytree(server.data_dir / "blobs", copy / "blobs")
    server.http.delete(f"/v1/fits/{fit['id']}")  # after the backup
    assert run_main(doctor, "--data-dir", str(copy)).returncode == 0
    server.stop()
    server.data_dir = copy
    restored = server.start().http
    assert restored.get(f"/v1/fits/{fit['id']}").json() == fit
    assert restored.get(f"/v1/measurements/{fit['measurement']}/content").content == data
