"""Settings: each is described, and a wrong one is refused in one sentence; the page on operations says what is so."""

import platform
import re
import runpy
import shutil
import socket
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from pydantic import ValidationError

from dsbrdf_service.admin.commands import doctor
from dsbrdf_service.settings import PREFIX, Settings
from tests.support.command_line import run_main, start_in_vain
from tests.support.server import QUICK, Server, StartServer


def test_failed_start_is_reported_in_one_sentence(tmp_path: Path) -> None:
    file, folder = tmp_path / "file", str(tmp_path / "data")
    file.touch()
    no_folder = f"{file} is not a folder; give a data folder that is new, empty or the service's"
    assert start_in_vain(tmp_path, "--data-dir", str(file)) == (2, f"dsbrdf: {no_folder}\n")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        in_use = f"cannot listen on port {port} of 127.0.0.1: Address already in use."
        assert start_in_vain(tmp_path, "--data-dir", folder, "--port", str(port)) == (1, f"dsbrdf: {in_use}\n")


def test_number_with_too_many_digits_is_refused_for_each_setting() -> None:
    numbers = [name for name, field in Settings.model_fields.items() if field.annotation is int]
    assert len(numbers) == 11
    for name in numbers:
        with pytest.raises(ValidationError, match=f"{name}\n  Input should be less than "):
            Settings.model_validate({name: "9" * 400})


def test_empty_environment_variable_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in Settings.model_fields:
        monkeypatch.setenv(f"DSBRDF_{name.upper()}", "")
    assert Settings() == Settings(_env_prefix="NOTHING_")  # type: ignore[call-arg]


DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "operations.md").read_text()


def test_table_of_settings_is_up_to_date() -> None:
    with_table = runpy.run_path(str(DOCS / "_ext/settings_table.py"))["with_table"]
    assert with_table(PAGE) == PAGE, "run: python docs/_ext/settings_table.py"


def test_settings_that_are_mentioned_exist() -> None:
    mentioned = set(re.findall(rf"\b{PREFIX}[A-Z_]+", PAGE))
    assert mentioned == {PREFIX + name.upper() for name in Settings.model_fields}


def test_every_metric_is_explained(server: Server) -> None:
    text = server.http.get("/metrics").text
    assert "\nprocess_resident_memory_bytes " in text
    exposed = set(re.findall(r"^# TYPE (dsbrdf_\w+) (?:counter|gauge|histogram)$", text, re.MULTILINE))
    explained = set(re.findall(r"^\| `(dsbrdf_\w+)", PAGE, re.MULTILINE))
    assert {name for name in exposed if not name.endswith("_created")} == explained


@pytest.mark.slow
def test_backup_of_a_running_service_can_be_restored(own_server: StartServer, data: bytes, tmp_path: Path) -> None:
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


PROGRAM = """
from pathlib import Path
from dsbrdf.process_settings import trim_memory

def megabytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

kept = [bytes(3000) for _ in range(40_000)]
last = bytes(3000)  # at the end of the heap, which therefore does not shrink by itself
kept.clear()
before = megabytes()
trim_memory()
print(before - megabytes())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries return memory as they like")
def test_free_memory_is_returned() -> None:
    answer = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert float(answer.stdout) > 60
