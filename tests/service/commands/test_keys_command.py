"""``dsbrdf keys``, beside a running server."""

import json
import re
import subprocess
import sys
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from service.access.keys import add_key, revoke_key
from service.storage.database import Database
from tests.support.commands import start_in_vain
from tests.support.guarded import Guarded, keys_command
from tests.support.processes import wait_until
from tests.support.server import Server, assert_problem
from tests.support.soak import SOAK


def test_keys_are_added_listed_and_revoked_beside_a_running_server(guarded: Guarded) -> None:
    server = guarded.server
    there = ("--data-dir", str(server.data_dir))
    words = ["add", "carol's laptop", *there, "--requests-per-second", "7", "--stored-mb", "80"]
    run = [sys.executable, "-m", "dsbrdf.cli.main", "keys", *words]
    added = subprocess.run(run, capture_output=True, text=True, timeout=60, check=True)
    key = added.stdout.removesuffix("\n")
    assert re.fullmatch(r"dsbrdf_[0-9a-f]{12}_[\w-]{43}", key)
    key_id = key.split("_")[1]
    assert key_id in added.stderr
    assert key not in added.stderr
    header = {"Authorization": f"Bearer {key}"}
    wait_until(lambda: server.http.get("/v1/fits", headers=header).status_code == 200)

    (document,) = [item for item in listed(server) if item["id"] == key_id]
    assert abs(datetime.fromisoformat(document["created"]) - datetime.now(UTC)) < timedelta(minutes=5)
    assert {name: document[name] for name in document if name != "created"} == {
        "id": key_id,
        "name": "carol's laptop",
        "used": None,
        "revoked": None,
        "metrics": False,
        "requests_per_second": 7.0,
        "stored_mb": 80,
        "queued_fits": None,
    }
    assert "carol's laptop" in keys_command("list", *there).stdout

    before = listed(server)
    for wrong in ("*", "%", "' OR 1=1 --", "", key_id[:-1], f"{key_id} ", key):
        refused = keys_command("revoke", wrong, *there)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
        assert key not in refused.stderr
    assert listed(server) == before
    assert keys_command("revoke", key_id, *there).returncode == 0
    seconds = wait_until(lambda: server.http.get("/v1/fits", headers=header).status_code == 401)
    assert not SOAK or seconds < 1.2
    first = [item["revoked"] for item in listed(server) if item["id"] == key_id]
    assert first != [None]
    assert keys_command("revoke", key_id, *there).returncode == 0
    assert [item["revoked"] for item in listed(server) if item["id"] == key_id] == first


def listed(server: Server) -> list[dict[str, Any]]:
    document = json.loads(keys_command("list", "--json", "--data-dir", str(server.data_dir)).stdout)
    items: list[dict[str, Any]] = document["items"]
    return items


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["add", "x", "--requests-per-second", "0"], "rate"),
        (["add", "x", "--requests-per-second", "nan"], "rate"),
        (["add", "x", "--stored-mb", "-1"], "bound"),
        (["add", "x", "--queued-fits", "1.5"], "queued-fits"),
        (["add", "a\nb"], "printable"),
        (["add", "x" * 101], "printable"),
        (["add"], "NAME"),
        ([], "name a command"),
        (["list"], "data folder"),
    ],
)
def test_invalid_arguments_are_refused_in_one_sentence(tmp_path: Path, words: list[str], part: str) -> None:
    folder = tmp_path / "none"
    there = ["--data-dir", str(folder)] if words else []
    refused = keys_command(*words, *there)
    assert (refused.returncode, refused.stderr.count("\n"), refused.stdout) == (2, 1, "")
    assert part in refused.stderr
    assert not folder.exists()


def test_new_key_tells_that_its_data_folder_is_new(tmp_path: Path) -> None:
    there = ("--data-dir", str(tmp_path / "wrong"))
    assert f"{tmp_path / 'wrong'} becomes a new data folder" in keys_command("add", "x", *there).stderr
    assert "new data folder" not in keys_command("add", "y", *there).stderr


def test_service_on_a_public_address_requires_an_active_key(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    with closing(Database(folder)) as database:
        revoke_key(database, add_key(database, "x")[0].id)
    code, said = start_in_vain(tmp_path, "--host", "0.0.0.0", "--port", "0", "--data-dir", str(folder))
    assert code == 2
    assert "dsbrdf keys add" in said
    with closing(Database(folder)) as database:
        _, key = add_key(database, "y")
    with Server.running(folder, host="0.0.0.0") as server:
        assert_problem(server.http.get("/v1/fits"), 401, "unauthorized")
        assert server.http.get("/v1/fits", headers={"Authorization": f"Bearer {key}"}).status_code == 200
