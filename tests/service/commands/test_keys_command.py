"""``dsbrdf keys``, beside a running server."""

import json
import re
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from dsbrdf.cli.main import main
from service.access.keys import add_key, revoke_key
from service.storage.database import Database
from tests.support.commands import run_main, start_in_vain
from tests.support.guarded import Guarded, keys_command
from tests.support.processes import wait_until
from tests.support.server import Server, assert_problem
from tests.support.soak import SOAK


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
    assert document == {"id": key_id, "name": "carol's laptop", "used": None, "revoked": None} | limits
    assert type(document["metrics"]) is bool
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
    first = listed(server)[key_id]["revoked"]
    assert first is not None
    assert keys_command("revoke", key_id, *there).returncode == 0
    assert listed(server)[key_id]["revoked"] == first


def listed(server: Server) -> dict[str, dict[str, Any]]:
    document = json.loads(keys_command("list", "--json", "--data-dir", str(server.data_dir)).stdout)
    return {item["id"]: item for item in document["items"]}


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
    assert (code, "dsbrdf keys add" in said) == (2, True)
    with closing(Database(folder)) as database:
        _, key = add_key(database, "y")
    with Server.running(folder, host="0.0.0.0") as server:
        assert_problem(server.http.get("/v1/fits"), 401, "unauthorized")
        assert server.http.get("/v1/fits", headers={"Authorization": f"Bearer {key}"}).status_code == 200
