"""Keys: who is let in, how often, and with how much; and that a key is known to nobody but its owner."""

import time
from contextlib import closing
from pathlib import Path

import pytest

from service.access.keys import Keys, add_key, all_keys, revoke_key
from service.settings import Settings
from service.storage.database import Database
from tests.support.guarded import Guarded, keys_command


def test_secrets_are_neither_stored_nor_printed(guarded: Guarded, data: bytes) -> None:
    server = guarded.server
    header = guarded.new_key("for a search")
    key = header["Authorization"].removeprefix("Bearer ")
    secret = key.split("_", 2)[2]
    assert server.http.post("/v1/measurements", content=data, headers=header).status_code == 201
    assert server.http.get("/v1/fits?cursor=x", headers=header).status_code == 422
    assert server.http.get("/v1/fits", headers=header | {"Authorization": f"Bearer {key}x"}).status_code == 401
    assert server.http.get(f"/v1/fits/{'0' * 32}", headers=header).status_code == 404
    texts = {path.name: path.read_bytes() for path in server.data_dir.glob("dsbrdf.sqlite*")}
    assert "dsbrdf.sqlite-wal" in texts
    texts["log"] = server.log.read_bytes()
    for kind in ([], ["--json"]):
        texts[str(kind)] = keys_command("list", *kind, "--data-dir", str(server.data_dir)).stdout.encode()
        assert b"for a search" in texts[str(kind)]
    assert b"for a search" in b"".join(text for name, text in texts.items() if name.startswith("dsbrdf"))
    for name, text in texts.items():
        assert secret.encode() not in text, name


def test_unknown_key_ids_are_compared_in_constant_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[tuple[bytes, bytes]] = []

    def compare(one: bytes, other: bytes) -> bool:
        compared.append((one, other))
        return one == other

    monkeypatch.setattr("service.access.keys.hmac.compare_digest", compare)
    with closing(Database(tmp_path)) as database:
        row, key = add_key(database, "x")
        active = Keys(Settings())
        assert active.find(key.encode()) is None  # not loaded
        active.load(database)
        found = active.find(key.encode())
        assert (found and found.caller.owner) == row.id
        for wrong in (key.replace(row.id, "0" * 12), key[:-1] + "_"):
            assert active.find(wrong.encode()) is None
        revoke_key(database, row.id)
        active.load(database)
        assert active.find(key.encode()) is None
    assert [len(part) for pair in compared for part in pair] == [32] * 10


def test_damaged_or_locked_database_is_reported_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "dsbrdf.sqlite").write_bytes(b"no database" * 1000)
    refused = keys_command("list", "--data-dir", str(tmp_path))
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "cannot be opened" in refused.stderr
    (tmp_path / "dsbrdf.sqlite").unlink()
    monkeypatch.setattr("service.storage.database._COMMAND_BUSY_TIMEOUT", 0.1)
    with closing(Database(tmp_path)) as database, database.transaction():
        busy = keys_command("add", "x", "--data-dir", str(tmp_path))
    assert busy.returncode in (1, 2)
    assert (busy.stderr.count("\n"), busy.stdout) == (1, "")
    assert "locked" in busy.stderr


def test_last_use_of_a_key_is_written_but_not_at_each_request(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    database = Database(tmp_path)
    (used, key), (unused, _) = add_key(database, "a"), add_key(database, "b")
    keys = Keys(Settings())
    keys.load(database)
    assert keys.find(key[:-1].encode() + b"?") is None
    keys.write_uses(database)
    assert [row.used for row in all_keys(database)] == [None, None]
    for _ in range(3):
        assert keys.find(key.encode()) is not None
    keys.write_uses(database)
    monkeypatch.setattr(database, "transaction", pytest.fail)
    keys.write_uses(database)  # nothing is left to be written
    times = {row.id: row.used for row in all_keys(database)}
    assert times[unused.id] is None
    assert abs((times[used.id] or 0.0) - time.time()) < 60.0
    database.close()
