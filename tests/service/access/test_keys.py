"""Keys: who is let in, how often, and with how much; and that a key is known to nobody but its owner."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import httpx
import pytest

from dsbrdf_service.access import keys as keys_module
from dsbrdf_service.access.keys import Keys, add_key, revoke_key
from dsbrdf_service.errors import InvalidKeyError
from dsbrdf_service.settings import Settings
from dsbrdf_service.storage.database import Database
from dsbrdf_service.storage.schema import Caller
from dsbrdf_service.storage.store import Store
from tests.support.guarded import Guarded, keys_command
from tests.support.server import ENDLESS, QUICK, assert_problem
from tests.support.stores import add, receive


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

    monkeypatch.setattr("dsbrdf_service.access.keys.hmac.compare_digest", compare)
    with closing(Database(tmp_path)) as database:
        row, key = add_key(database, "x")
        active = Keys(Settings())
        active.open(database)
        found = active.find(key.encode())
        assert (found and found.owner) == row.id
        for wrong in (key.replace(row.id, "0" * 12), key[:-1] + "_"):
            assert active.find(wrong.encode()) is None
        revoke_key(database, row.id)
        assert active.find(key.encode()) is None
    assert [len(part) for pair in compared for part in pair] == [32] * 8


def test_locked_database_is_reported_in_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dsbrdf_service.storage.database._BUSY_TIMEOUT", 0.1)
    with closing(Database(tmp_path)) as database, database.transaction():
        busy = keys_command("add", "x", "--data-dir", str(tmp_path))
    assert busy.returncode in (1, 2)
    assert (busy.stderr.count("\n"), busy.stdout) == (1, "")
    assert "locked" in busy.stderr


def test_keys_without_limits_of_their_own_have_those_of_the_settings(tmp_path: Path) -> None:
    settings = Settings(key_requests_per_second=3.0, key_stored_mb=40, key_queued_fits=5)
    with closing(Database(tmp_path)) as database:
        (usual, usual_key), (own, own_key) = add_key(database, "a"), add_key(database, "b", stored_mb=6, queued_fits=7)
        keys = Keys(settings)
        keys.open(database)
        found = [keys.find(key.encode()) for key in (usual_key, own_key)]
    assert found == [
        Caller(usual.id, stored_bytes=40_000_000, queued_fits=5, metrics=False, requests_per_second=3.0),
        Caller(own.id, stored_bytes=6_000_000, queued_fits=7, metrics=False, requests_per_second=3.0),
    ]


def test_revoked_key_stores_nothing_and_its_waiting_fits_are_cancelled(tmp_path: Path) -> None:
    with closing(Store(tmp_path)) as store:
        key, other = (add_key(store.database, name)[0].id for name in ("revoked", "other"))
        fits = {}
        for owner in (key, other):
            sha256 = add(store, b"content", Caller(owner))
            fits[owner] = [store.add_fit(Caller(owner), sha256, {"n_lobes": n}, 10)[0].key for n in range(3)]
            store.start_fit(fits[owner][0])
        incoming = receive(store, b"sent meanwhile")
        revoke_key(store.database, key)
        assert [store.fit(fit).status for fit in fits[key]] == ["running", "cancelled", "cancelled"]
        assert [store.fit(fit).status for fit in fits[other]] == ["running", "accepted", "accepted"]
        with pytest.raises(InvalidKeyError):
            store.add_measurement(Caller(key), incoming)
        assert not store.blobs.path(incoming.sha256).exists()
        with pytest.raises(InvalidKeyError):
            store.add_fit(Caller(key), sha256, {"n_lobes": 4}, 10)
        assert store.add_measurement(Caller(other), incoming)[1]


def test_requests_of_five_seconds_may_come_at_once_and_more_at_their_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(keys_module, "monotonic", lambda: now)
    keys, key, slow = Keys(Settings()), Caller("a", requests_per_second=4.0), Caller("b", requests_per_second=0.01)
    assert [keys.wait(key) for _ in range(20)] == [0.0] * 20
    assert keys.wait(key) == pytest.approx(0.25)
    now += 0.2
    assert keys.wait(key) == pytest.approx(0.05)
    now += 0.05 + 1e-9
    assert keys.wait(key) == 0.0
    assert keys.wait(key) > 0.0
    now += 1e6
    assert [keys.wait(key) for _ in range(20)] == [0.0] * 20
    assert keys.wait(key) > 0.0
    assert keys.wait(slow) == 0.0
    assert keys.wait(slow) == pytest.approx(100.0)


def test_rate_limit_counts_each_key_alone(guarded: Guarded) -> None:
    header = guarded.new_key("slow", requests_per_second=0.02)  # and its one request is made
    answer = guarded.server.http.get("/v1/fits", headers=header)
    assert "0.02 requests per second" in assert_problem(answer, 429, "rate-limited")
    assert 1 <= int(answer.headers["retry-after"]) <= 50
    assert [guarded.server.http.get("/v1/fits", headers=guarded.bob).status_code for _ in range(20)] == [200] * 20
    assert guarded.server.http.get("/v1/fits", headers=header).status_code == 429


def test_upload_over_quota_is_refused_and_not_stored(guarded: Guarded, data: bytes) -> None:
    server = guarded.server
    header = guarded.new_key("full", stored_mb=74)  # room for two files of 35.0 MB
    before = set(server.files())

    def upload(content: bytes) -> httpx.Response:
        return server.http.post("/v1/measurements", content=content, headers=header)

    files = [data[:-8] + bytes([100 + number, *data[-7:]]) for number in range(6)]  # which no other test has
    with ThreadPoolExecutor(len(files)) as pool:
        answers = list(pool.map(upload, files))
    assert sorted(answer.status_code for answer in answers) == [201, 201, 403, 403, 403, 403]
    by_status = {answer.status_code: content for content, answer in zip(files, answers, strict=True)}
    assert len(set(server.files()) - before) == 2
    assert len(server.http.get("/v1/measurements", headers=header).json()["items"]) == 2

    again = upload(by_status[201])
    assert again.status_code == 200  # nothing more is stored
    refused = server.http.post("/v1/fits", params=QUICK, content=by_status[403], headers=header)
    detail = assert_problem(refused, 403, "storage-quota")
    assert detail.startswith("this key has stored 70.0 of 74.0 MB and ")
    sha256 = again.json()["sha256"]
    assert server.http.delete(f"/v1/measurements/{sha256}", headers=header).status_code == 204
    assert upload(by_status[403]).status_code == 201


def test_unfinished_fits_of_a_key_are_limited(guarded: Guarded, data: bytes) -> None:
    server = guarded.server
    header = guarded.new_key("busy", queued_fits=2)
    sha256 = server.http.post("/v1/measurements", content=data, headers=header).json()["sha256"]

    def submit(number: int, **other: str) -> httpx.Response:
        document = {"measurement": sha256, "options": {**ENDLESS, "mask": number / 100}}
        return server.http.post("/v1/fits", json=document, headers={**header, "Prefer": "respond-async", **other})

    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(submit, range(6)))
    assert sorted(answer.status_code for answer in answers) == [202, 202, 429, 429, 429, 429]
    accepted = [number for number, answer in enumerate(answers) if answer.status_code == 202]
    refused = next(number for number, answer in enumerate(answers) if answer.status_code == 429)
    assert_problem(answers[refused], 429, "queue-quota")
    assert int(answers[refused].headers["retry-after"]) >= 1
    assert submit(accepted[0]).status_code in (200, 202)  # the same fit

    server.http.post("/v1/measurements", content=data, headers=guarded.bob)
    of_bob = submit(refused, **guarded.bob)
    assert of_bob.status_code == 202
    for number in accepted:
        server.http.delete(f"/v1/fits/{answers[number].json()['id']}", headers=header)
    again = submit(refused)
    assert again.status_code == 202
    for answer, who in ((again, header), (of_bob, guarded.bob)):
        assert server.http.delete(answer.headers["location"], headers=who).json()["status"] == "cancelled"
