"""Keys: who is let in, how often, and with how much; and that a key is known to nobody but its owner."""

import hashlib
import http.client
import io
import json
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.access import keys as keys_module
from service.access.keys import KeyLimits, Keys, RateLimit, add_key, all_keys, revoke_key
from service.client import AccessError, Client, LimitError, ServiceError
from service.commands import keys as keys_command
from service.settings import Settings
from service.storage.database import Database
from tests.service.conftest import Guarded, new_key
from tests.service.running import ENDLESS, QUICK, Server, assert_problem, wait_until

OPEN = ("/health/live", "/health/ready", "/docs", "/docs/page.js", "/openapi.json")


def command(*words: str) -> "subprocess.CompletedProcess[str]":
    """Run the command as ``dsbrdf keys`` runs it, without a process of its own."""
    output, errors = io.StringIO(), io.StringIO()
    with redirect_stdout(output), redirect_stderr(errors):
        try:
            code = keys_command.main(words)
        except SystemExit as stop:
            code = int(str(stop.code))
    return subprocess.CompletedProcess(words, code, output.getvalue(), errors.getvalue())


def variants(data: bytes, count: int) -> list[bytes]:
    """Different acceptable measurements of the same size, which no other test has."""
    return [data[:-8] + bytes([100 + number, *data[-7:]]) for number in range(count)]


def bad_headers(key: str) -> dict[str, list[tuple[bytes, bytes]]]:
    """Authorization headers that must not let anyone in, made of a good key."""
    prefix, key_id, secret = key.split("_", 2)
    other = "A" if secret[0] != "A" else "B"

    def bearer(text: str) -> list[tuple[bytes, bytes]]:
        return [(b"Authorization", b"Bearer " + text.encode("latin-1"))]

    good = f"Bearer {key}".encode()
    return {
        "none": [],
        "empty": [(b"Authorization", b"")],
        "scheme alone": [(b"Authorization", b"Bearer")],
        "no scheme": [(b"Authorization", key.encode())],
        "basic": [(b"Authorization", b"Basic " + key.encode())],
        "longer scheme": [(b"Authorization", b"Bearerx " + key.encode())],
        "tab": [(b"Authorization", b"Bearer\t" + key.encode())],
        "two tokens": bearer(f"{key} {key}"),
        "a list": bearer(f"{key}, {key}"),
        "a list of schemes": [(b"Authorization", b"Basic x, " + good)],
        "quoted": bearer(f'"{key}"'),
        "same header twice": [(b"Authorization", good), (b"Authorization", good)],
        "good before bad": [(b"Authorization", good), (b"Authorization", b"Bearer x")],
        "bad before good": [(b"authorization", b"Basic eDp4"), (b"AUTHORIZATION", good)],
        "another header": [(b"Proxy-Authorization", good), (b"X-Api-Key", key.encode()), (b"Cookie", b"key=" + good)],
        "wrong secret": bearer(f"{prefix}_{key_id}_{other}{secret[1:]}"),
        "wrong end": bearer(f"{key[:-1]}{'A' if key[-1] != 'A' else 'E'}"),
        "cut off": bearer(key[:-1]),
        "longer": bearer(f"{key}A"),
        "no secret": bearer(f"{prefix}_{key_id}_"),
        "unknown id": bearer(f"{prefix}_{'0' * 12}_{secret}"),
        "upper case": bearer(key.upper()),
        "other prefix": bearer(f"DSBRDF_{key_id}_{secret}"),
        "any character": bearer(f"{prefix}_{'_' * 12}_{secret}"),
        "like": bearer(f"{prefix}_%_{secret}"),
        "glob": bearer(f"{prefix}_*_{secret}"),
        "sql": bearer(f"{prefix}_' OR 1=1 --_{secret}"),
        "sql of the right length": bearer(f"{prefix}_' OR ''='' --_{secret}"),
        "not ascii": bearer(f"{key[:-1]}é"),
        "utf-8 digits": [(b"Authorization", f"Bearer {key[:-1]}٣".encode())],
        "null": bearer(f"{prefix}_{key_id}_{'0' * 43}"),
        "very long": bearer(key + "A" * 30_000),
        "very long id": bearer(f"{prefix}_{'0' * 30_000}_{secret}"),
    }


@pytest.mark.parametrize("case", bad_headers("dsbrdf_0_secret"))
def test_nothing_but_a_key_lets_anyone_in(guarded: Guarded, case: str) -> None:
    key = guarded.alice["Authorization"].removeprefix("Bearer ")
    headers = bad_headers(key)[case]
    answer = guarded.server.http.get("/v1/fits", headers=headers)
    detail = assert_problem(answer, 401, "unauthorized")
    assert "Authorization: Bearer" in detail
    assert answer.headers["www-authenticate"].startswith("Bearer")
    assert key not in answer.text
    if case not in ("none", "another header"):  # what is wrong with a key is not told
        unknown = guarded.server.http.get("/v1/fits", headers=bad_headers(key)["unknown id"])
        assert answer.content == unknown.content


@pytest.mark.parametrize("scheme", ["Bearer", "bearer", "BEARER"])
def test_a_key_lets_its_owner_in(guarded: Guarded, scheme: str) -> None:
    key = guarded.alice["Authorization"].removeprefix("Bearer ")
    answer = guarded.server.http.get("/v1/fits", headers={"authorization": f"{scheme}  {key}"})
    assert answer.status_code == 200


def test_every_route_wants_a_key(guarded: Guarded) -> None:
    paths: dict[str, dict[str, Any]] = guarded.server.http.get("/openapi.json").json()["paths"]
    tried = 0
    for path, methods in paths.items():
        for method in {*methods, "get", "head", "post", "put", "patch", "delete", "options", "trace"}:
            filled = path.replace("{fit_id}", "0" * 32).replace("{sha256}", "0" * 64).replace("{label}", "diffuse")
            answer = guarded.server.http.request(method.upper(), filled)
            assert (answer.status_code == 401) is (path not in OPEN), (method, path, answer.status_code)
            tried += 1
    assert tried > 50
    for path in OPEN:
        assert guarded.server.http.get(path).status_code == 200


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "//v1/fits",
        "/v1//fits",
        "/v1/fits/",
        "/V1/fits",
        "/v1/fits?/health/live",
        "/v1/fits;/health/live",
        "/v1/fits%0A",
        "/v1/fits%00/health/live",
        "/health/live%0A",
        "/health/live%00",
        "/health/live/",
        "//health/live",
        "/health//live",
        "/HEALTH/live",
        "/health/live/../../v1/fits",
        "/health/live/..%2f..%2fv1/fits",
        "/health/live%2f..%2f..%2fv1%2ffits",
        "/docs/../v1/fits",
        "/docs/oauth2-redirect",
        "/docs/",
        "/docs/page.js/",
        "/docs/page.js/../../v1/fits",
        "/docs/page.js%2f..%2f..%2fv1%2ffits",
        "/openapi.json/../v1/fits",
        "/%2e%2e/v1/fits",
        "/metrics",
        "http://localhost/v1/fits",
        "http://localhost/health/live/../../v1/fits",
        "*",
    ],
)
def test_no_path_goes_around_the_gate(guarded: Guarded, path: str) -> None:
    url = guarded.server.http.base_url
    for method in ("GET", "DELETE"):
        connection = http.client.HTTPConnection(url.host, url.port, timeout=30)
        connection.request(method, path)
        answer = connection.getresponse()
        body = answer.read()
        assert answer.status == 401, body
        connection.close()


def test_an_upload_without_a_key_is_refused_before_it_is_read(guarded: Guarded, data: bytes) -> None:
    before = guarded.server.files()
    for headers in ({}, {"Authorization": "Bearer x"}):
        for path in ("/v1/measurements", "/v1/fits"):
            try:
                answer = guarded.server.http.post(path, content=data, headers=headers)
            except (httpx.NetworkError, httpx.RemoteProtocolError):  # closed while it was being sent, which is as good
                continue
            assert_problem(answer, 401, "unauthorized")
    assert guarded.server.files() == before


def test_no_secret_is_kept_or_told(guarded: Guarded, data: bytes) -> None:
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
    texts["list"] = command("list", "--json", "--data-dir", str(server.data_dir)).stdout.encode()
    texts["text"] = command("list", "--data-dir", str(server.data_dir)).stdout.encode()
    texts["metrics"] = server.http.get("/metrics", headers=header).content
    assert b"for a search" in b"".join(text for name, text in texts.items() if name.startswith("dsbrdf"))
    assert b"for a search" in texts["list"]
    for name, text in texts.items():
        assert secret.encode() not in text, name


def test_comparisons_take_the_same_way_for_unknown_ids(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[tuple[bytes, bytes]] = []

    def compare(one: bytes, other: bytes) -> bool:
        compared.append((one, other))
        return one == other

    monkeypatch.setattr("service.access.keys.hmac.compare_digest", compare)
    database = Database(tmp_path)
    row, key = add_key(database, "x", KeyLimits())
    active = Keys(Settings())
    assert active.find(key.encode()) is None  # not loaded
    active.load(database)
    found = active.find(key.encode())
    assert found is not None
    assert found.caller.owner == row.id
    assert active.find(key.replace(row.id, "0" * 12).encode()) is None
    assert active.find((key[:-1] + "_").encode()) is None
    assert len(compared) == 4
    assert {len(part) for pair in compared for part in pair} == {32}
    revoke_key(database, row.id)
    active.load(database)
    assert active.find(key.encode()) is None
    assert len(compared) == 5
    database.close()


def test_the_command_adds_lists_and_revokes_beside_a_running_server(guarded: Guarded) -> None:
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
    assert document["created"][:3] == "202"
    assert {name: document[name] for name in document if name != "created"} == {
        "id": key_id,
        "name": "carol's laptop",
        "revoked": None,
        "requests_per_second": 7.0,
        "stored_mb": 80,
        "queued_fits": None,
    }
    assert "carol's laptop" in command("list", *there).stdout

    before = listed(server)
    for wrong in ("*", "%", "_", "[0-9a-f]*", "' OR 1=1 --", "", key_id[:-1], f"{key_id} ", f"{key_id}\0", key):
        refused = command("revoke", wrong, *there)
        assert refused.returncode == 2
        assert refused.stderr.count("\n") == 1
        assert key not in refused.stderr
    assert listed(server) == before
    assert command("revoke", key_id, *there).returncode == 0
    wait_until(lambda: server.http.get("/v1/fits", headers=header).status_code == 401)
    assert [item["revoked"] is None for item in listed(server) if item["id"] == key_id] == [False]


def listed(server: Server) -> list[dict[str, Any]]:
    items: list[dict[str, Any]] = json.loads(command("list", "--json", "--data-dir", str(server.data_dir)).stdout)[
        "items"
    ]
    return items


def is_refused(server: Server, header: dict[str, str]) -> bool:
    return server.http.get("/v1/fits", headers=header).status_code == 401


def test_a_revoked_key_is_refused_within_about_a_second(guarded: Guarded) -> None:
    database = Database(guarded.server.data_dir, exclusive=False)
    took = []
    for _ in range(3):
        key_id, header = new_key(guarded.server, "brief")
        assert revoke_key(database, key_id)
        refused = partial(is_refused, guarded.server, header)
        took.append(wait_until(refused))
    assert min(took) < 1.2  # the others may have met a busy machine
    (first,) = [row for row in all_keys(database) if row.id == key_id]
    assert revoke_key(database, key_id)
    assert [row for row in all_keys(database) if row.id == key_id] == [first]
    database.close()


def test_what_waits_ends_with_its_key(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server(require_keys="true", workers="1")
    (key_id, header), (_, other) = (new_key(server, name) for name in ("brief", "lasting"))
    address = (server.http.base_url.host, server.http.base_url.port)
    document = {"measurement": hashlib.sha256(data).hexdigest(), "options": ENDLESS}

    def submit(who: dict[str, str]) -> str:
        server.http.post("/v1/measurements", content=data, headers=who)
        fit: str = server.http.post("/v1/fits", json=document, headers={**who, "Prefer": "respond-async"}).json()["id"]
        return fit

    def poll() -> httpx.Response:
        return server.http.get(f"/v1/fits/{fit}?wait=300", headers=header)

    def post() -> httpx.Response:
        return server.http.post("/v1/fits", json=document, headers={**header, "Prefer": "wait=300"})

    def follow(who: dict[str, str]) -> str:
        with server.http.stream("GET", f"/v1/fits/{fit}/events", headers=who) as answer:
            assert answer.status_code == 200
            return answer.read().decode()  # to an end: a connection that breaks off is an error

    fit = submit(header)
    assert submit(other) == fit
    head = f"POST /v1/measurements HTTP/1.1\r\nHost: x\r\nAuthorization: {header['Authorization']}\r\n"
    with ThreadPoolExecutor(4) as pool, socket.create_connection(address, timeout=60) as upload:
        upload.sendall(f"{head}Content-Length: {len(data)}\r\n\r\n".encode() + data[:100_000])
        polled, posted, followed = pool.submit(poll), pool.submit(post), pool.submit(follow, header)
        lasting = pool.submit(follow, other)
        in_progress = re.compile(r"^dsbrdf_requests_in_progress 6.0$", re.MULTILINE)
        wait_until(lambda: bool(in_progress.search(server.http.get("/metrics", headers=other).text)))
        assert command("revoke", key_id, "--data-dir", str(server.data_dir)).returncode == 0
        assert_problem(polled.result(timeout=60), 401, "unauthorized")
        assert_problem(posted.result(timeout=60), 401, "unauthorized")
        assert "event: " in followed.result(timeout=60)
        # A revoked key is refused from the next request on; one that has begun ends as any other.
        upload.sendall(data[100_000:])
        assert upload.recv(10_000).startswith(b"HTTP/1.1 20")
        assert not lasting.done()
        assert server.http.get(f"/v1/fits/{fit}", headers=other).json()["status"] in ("accepted", "running")
        server.http.delete(f"/v1/fits/{fit}", headers=other)
        assert "event: cancelled" in lasting.result(timeout=60)
    assert '"level": "error"' not in server.log.read_text()


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["add", "x", "--requests-per-second", "0"], "rate"),
        (["add", "x", "--requests-per-second", "nan"], "rate"),
        (["add", "x", "--stored-mb", "-1"], "bound"),
        (["add", "x", "--stored-mb", "much"], "much is not a bound; a whole number from 0 is"),
        (["add", "x", "--requests-per-second", "fast"], "fast is not a rate; 0.001 or more is"),
        (["add", "x", "--queued-fits", "1.5"], "queued-fits"),
        (["add", "a\nb"], "printable"),
        (["add", ""], "printable"),
        (["add", "x" * 101], "printable"),
        (["add"], "NAME"),
        ([], "COMMAND"),
        (["list"], "data folder"),
        (["revoke", "0"], "data folder"),
    ],
)
def test_bad_words_are_one_sentence(tmp_path: Path, words: list[str], part: str) -> None:
    folder = tmp_path / "none"
    there = ["--data-dir", str(folder)] if words else []
    refused = command(*words, *there)
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert part in refused.stderr
    assert refused.stdout == ""
    assert not folder.exists()


def test_the_start_needs_a_key_where_others_can_come(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    start = [sys.executable, "-m", "service", "--host", "0.0.0.0", "--port", "0", "--data-dir", str(folder)]
    row_id = command("add", "x", "--data-dir", str(folder)).stdout.split("_")[1]
    database = Database(folder)
    revoke_key(database, row_id)
    database.close()
    refused = subprocess.run(start, capture_output=True, text=True, timeout=60, check=False)
    assert refused.returncode == 2
    assert "dsbrdf keys add" in refused.stderr
    database = Database(folder)
    _, key = add_key(database, "y", KeyLimits())
    database.close()
    server = Server(folder, host="0.0.0.0")
    try:
        server.start()
        assert_problem(server.http.get("/v1/fits"), 401, "unauthorized")
        assert server.http.get("/v1/fits", headers={"Authorization": f"Bearer {key}"}).status_code == 200
    finally:
        server.close()


def test_a_damaged_or_busy_database_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "dsbrdf.sqlite").write_bytes(b"no database" * 1000)
    refused = command("list", "--data-dir", str(tmp_path))
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert "cannot be opened" in refused.stderr
    (tmp_path / "dsbrdf.sqlite").unlink()
    monkeypatch.setattr("service.storage.database._COMMAND_BUSY_TIMEOUT", 0.1)
    database = Database(tmp_path)
    with database.transaction():
        busy = command("add", "x", "--data-dir", str(tmp_path))
    assert busy.returncode in (1, 2)
    assert busy.stderr.count("\n") == 1
    assert "locked" in busy.stderr
    assert busy.stdout == ""
    database.close()


def test_a_new_folder_is_for_its_user_alone(tmp_path: Path) -> None:
    Database(tmp_path / "data").close()
    assert (tmp_path / "data").stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize(
    "host", ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "10.0.0.1", "evil."]
)
def test_a_name_that_was_made_to_lead_here_is_not_answered(server: Server, host: str) -> None:
    for value in (host, f"{host}:{server.http.base_url.port}"):
        answer = server.http.get("/v1/fits", headers={"Host": value})
        assert "127.0.0.1" in assert_problem(answer, 401, "unauthorized")


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:80", "workstation", "127.0.0.1", "127.1.2.3:8000", "[::1]:8000"]
)
def test_names_of_the_machine_itself_are_answered(server: Server, host: str) -> None:
    assert server.http.get("/v1/fits", headers={"Host": host}).status_code == 200
    assert server.http.get("/v1/fits", headers={"Host": host, "Origin": f"http://{host}"}).status_code == 200


@pytest.mark.parametrize("origin", ["https://evil.example", "null", "http://localhost:1", "", "127.0.0.1"])
def test_pages_of_other_sites_are_not_answered(server: Server, data: bytes, origin: str) -> None:
    before = server.files()
    answer = server.http.post("/v1/measurements", content=data[:100], headers={"Origin": origin})
    assert "other sites" in assert_problem(answer, 401, "unauthorized")
    assert server.files() == before


def test_a_key_that_is_sent_counts_on_loopback_too(server: Server) -> None:
    _, header = new_key(server, "x")
    assert server.http.get("/v1/fits").status_code == 200
    assert server.http.get("/v1/fits", headers=header | {"Host": "any.example"}).status_code == 200
    for wrong in ("", "Bearer", "Bearer x", header["Authorization"] + "x"):
        assert_problem(server.http.get("/v1/fits", headers={"Authorization": wrong}), 401, "unauthorized")


def test_a_bucket_gives_what_it_promises(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(keys_module, "monotonic", lambda: now)
    bucket = RateLimit(4.0)
    assert [bucket.take() for _ in range(20)] == [0.0] * 20
    assert bucket.take() == pytest.approx(0.25)
    now += 0.2
    assert bucket.take() == pytest.approx(0.05)
    now += 0.05 + 1e-9
    assert bucket.take() == 0.0
    assert bucket.take() > 0.0
    now += 1e6
    assert [bucket.take() for _ in range(20)] == [0.0] * 20
    assert bucket.take() > 0.0
    slow = RateLimit(0.01)
    assert slow.take() == 0.0
    assert slow.take() == pytest.approx(100.0)


def test_the_rate_of_one_key_does_not_bound_another(guarded: Guarded) -> None:
    header = guarded.new_key("slow", requests_per_second=0.02)  # and its one request is made
    answer = guarded.server.http.get("/v1/fits", headers=header)
    assert "0.02 requests per second" in assert_problem(answer, 429, "rate-limited")
    assert 1 <= int(answer.headers["retry-after"]) <= 50
    assert [guarded.server.http.get("/v1/fits", headers=guarded.bob).status_code for _ in range(20)] == [200] * 20
    # Keys are read again when another is made, which does not fill the bucket.
    guarded.new_key("reload")
    assert guarded.server.http.get("/v1/fits", headers=header).status_code == 429


def test_after_the_time_that_is_told_a_request_is_answered(guarded: Guarded) -> None:
    header = guarded.new_key("patient", requests_per_second=0.5)
    statuses = []
    for _ in range(10):
        answer = guarded.server.http.get("/v1/fits", headers=header)
        statuses.append(answer.status_code)
        if answer.status_code == 429:
            break
    assert statuses[-1] == 429
    time.sleep(int(answer.headers["retry-after"]))
    assert guarded.server.http.get("/v1/fits", headers=header).status_code == 200


def test_nothing_above_the_quota_is_stored(guarded: Guarded, data: bytes) -> None:
    server = guarded.server
    header = guarded.new_key("full", stored_mb=70)  # room for two files of 33.4 MB
    before = set(server.files())

    def upload(content: bytes) -> httpx.Response:
        return server.http.post("/v1/measurements", content=content, headers=header)

    files = variants(data, 6)
    with ThreadPoolExecutor(len(files)) as pool:
        answers = list(pool.map(upload, files))
    assert sorted(answer.status_code for answer in answers) == [201, 201, 403, 403, 403, 403]
    for answer in answers:
        if answer.status_code == 403:
            assert re.search(
                "this key has stored [0-9.]+ of 73.4 MB and ", assert_problem(answer, 403, "storage-quota")
            )
    assert len(set(server.files()) - before) == 2
    assert len(server.http.get("/v1/measurements", headers=header).json()["items"]) == 2

    stored = next(content for content, answer in zip(files, answers, strict=True) if answer.status_code == 201)
    refused = next(content for content, answer in zip(files, answers, strict=True) if answer.status_code == 403)
    assert upload(stored).status_code == 200  # nothing more is stored
    as_fit = server.http.post("/v1/fits", params=QUICK, content=refused, headers=header)
    assert_problem(as_fit, 403, "storage-quota")
    sha256 = upload(stored).json()["sha256"]
    assert server.http.delete(f"/v1/measurements/{sha256}", headers=header).status_code == 204
    assert upload(refused).status_code == 201


def test_unfinished_fits_are_bounded_for_each_key(guarded: Guarded, data: bytes) -> None:
    server = guarded.server
    header = guarded.new_key("busy", queued_fits=2)
    sha256 = server.http.post("/v1/measurements", content=data, headers=header).json()["sha256"]

    def submit(number: int, **other: str) -> httpx.Response:
        document = {"measurement": sha256, "options": {**ENDLESS, "mask": number / 100}}
        return server.http.post("/v1/fits", json=document, headers={**header, "Prefer": "respond-async", **other})

    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(submit, range(6)))
    assert sorted(answer.status_code for answer in answers) == [202, 202, 429, 429, 429, 429]
    for answer in answers:
        if answer.status_code == 429:
            assert_problem(answer, 429, "queue-quota")
            assert int(answer.headers["retry-after"]) >= 1
    accepted = [number for number, answer in enumerate(answers) if answer.status_code == 202]
    refused = next(number for number, answer in enumerate(answers) if answer.status_code == 429)
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


def head_of_answer_to_noise(server: Server) -> list[tuple[str, str]]:
    """Return the headers that something gets that is not HTTP."""
    address = server.http.base_url
    with socket.create_connection((address.host, address.port), timeout=30) as connection:
        connection.sendall(b"noise\r\n\r\n")
        status, *head = connection.recv(10_000).decode().partition("\r\n\r\n")[0].split("\r\n")
    assert " 400 " in status
    return [(name, value) for name, _, value in (line.partition(": ") for line in head)]


def test_every_answer_is_protected(guarded: Guarded) -> None:
    http_client = guarded.server.http
    answers = {
        "open": http_client.get("/health/live"),
        "documentation": http_client.get("/docs"),
        "script": http_client.get("/docs/swagger-ui-bundle.js"),
        "without key": http_client.get("/v1/fits"),
        "with key": http_client.get("/v1/fits", headers=guarded.alice),
        "missing": http_client.get("/nothing", headers=guarded.alice),
        "wrong method": http_client.put("/v1/fits", headers=guarded.alice),
        "with a slash": http_client.get("/v1/fits/", headers=guarded.alice),
        "no HTTP": httpx.Response(400, headers=head_of_answer_to_noise(guarded.server)),
    }
    for name, answer in answers.items():
        assert answer.headers["x-content-type-options"] == "nosniff", name
        assert answer.headers["x-frame-options"] == "DENY"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
        assert "Authorization" in answer.headers["vary"]
        assert answer.headers["cache-control"] == "private, no-cache"
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; ")
        assert "frame-ancestors 'none'" in policy
        assert ("script-src" in policy) is (name == "documentation")


def test_the_page_of_the_documentation_needs_nothing_from_elsewhere(guarded: Guarded) -> None:
    http_client = guarded.server.http
    page = http_client.get("/docs")
    policy = dict(part.split(" ", 1) for part in page.headers["content-security-policy"].split("; "))
    assert {source for sources in policy.values() for source in sources.split()} == {"'none'", "'self'", "data:"}
    assert (policy["default-src"], policy["script-src"], policy["style-src"]) == ("'none'", "'self'", "'self'")
    assert re.findall(r"<script(?! src=)|<style| style=| on[a-z]+=", page.text) == []
    named = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    script = http_client.get("/docs/page.js").text
    named += re.findall(r'url: "([^"]+)"', script)
    named.remove("data:,")
    types = {}
    for address in named:
        assert re.fullmatch(r"[\w./-]+", address)  # relative, and so of this service
        answer = http_client.get(page.url.join(address))
        assert answer.status_code == 200
        types[address] = answer.headers["content-type"].partition(";")[0]
        known = http_client.get(page.url.join(address), headers={"If-None-Match": answer.headers.get("etag", "")})
        assert known.status_code == (304 if address.startswith("docs/") else 200)
    assert types == {
        "docs/swagger-ui.css": "text/css",
        "docs/swagger-ui-bundle.js": "text/javascript",
        "docs/page.js": "text/javascript",
        "openapi.json": "application/json",
    }
    call = re.match(r'(\w+)\(.*dom_id: "#(\w+)"', script)
    assert call is not None
    assert f'id="{call[2]}"' in page.text
    assert call[1] in http_client.get("/docs/swagger-ui-bundle.js").text
    assert ".swagger-ui" in http_client.get("/docs/swagger-ui.css").text
    for other in ("redoc.standalone.js", "favicon.png", "..%2fcore.py", ""):
        assert_problem(http_client.get(f"/docs/{other}", headers=guarded.alice), 404)


def test_the_client_sends_its_key_and_tells_what_was_refused(
    guarded: Guarded, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = str(guarded.server.http.base_url)
    key = guarded.new_key("client", queued_fits=0)["Authorization"].removeprefix("Bearer ")
    with Client(url, key=key) as client:
        sha256 = client.upload(data)
        assert client.measurement(sha256).values.shape == (3, 90, 90, 180)
        with pytest.raises(LimitError, match="unfinished") as limited:
            client.submit(data)
        assert limited.value.problem["status"] == 429
        assert limited.value.retry_after == 5.0
        with pytest.raises(ServiceError, match="There is no fit"):
            client.get("0" * 32)
    monkeypatch.setenv("DSBRDF_KEY", key)
    with Client(url) as client:
        assert list(client.fits()) == []
    monkeypatch.setenv("DSBRDF_KEY", key[:-2])
    with Client(url) as client:
        for call in (lambda: client.upload(data), lambda: list(client.fits()), lambda: client.delete("0" * 32)):
            with pytest.raises(AccessError, match="API key") as refused:
                call()
            assert refused.value.problem["status"] == 401
            assert key[:-2] not in str(refused.value)
    monkeypatch.delenv("DSBRDF_KEY")
    with Client(url) as client, pytest.raises(AccessError, match="API key"):
        client.upload(data)
    small = guarded.new_key("small", stored_mb=1)["Authorization"].removeprefix("Bearer ")
    with Client(url, key=small) as client, pytest.raises(LimitError, match="stored") as full:
        client.upload(data)
    assert full.value.retry_after is None
    with pytest.raises(ValueError, match="key"):
        Client(url, key="clé")
