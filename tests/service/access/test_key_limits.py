"""What a key may do and store, how often, and how much at once."""

import asyncio
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from starlette.types import Message

from service.access import keys as keys_module
from service.access.authentication import AuthenticationMiddleware
from service.access.keys import Keys, RateLimit
from service.settings import Settings
from tests.support.guarded import Guarded
from tests.support.server import ENDLESS, QUICK, assert_problem


def variants(data: bytes, count: int) -> list[bytes]:
    """Different acceptable measurements of the same size, which no other test has."""
    return [data[:-8] + bytes([100 + number, *data[-7:]]) for number in range(count)]


def test_token_bucket_refills_at_its_rate(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_rate_limit_counts_each_key_alone(guarded: Guarded) -> None:
    header = guarded.new_key("slow", requests_per_second=0.02)  # and its one request is made
    answer = guarded.server.http.get("/v1/fits", headers=header)
    assert "0.02 requests per second" in assert_problem(answer, 429, "rate-limited")
    assert 1 <= int(answer.headers["retry-after"]) <= 50
    assert [guarded.server.http.get("/v1/fits", headers=guarded.bob).status_code for _ in range(20)] == [200] * 20
    # Keys are read again when another is made, which does not fill the bucket.
    guarded.new_key("reload")
    assert guarded.server.http.get("/v1/fits", headers=header).status_code == 429


def test_refused_requests_of_one_caller_are_asked_to_come_one_after_the_other_within_a_minute() -> None:
    over, seconds = asyncio.Event(), list[int]()

    async def wait(*_: object) -> None:
        await over.wait()

    async def receive() -> Message:
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        if message["type"] == "http.response.start":
            assert message["status"] == 429
            seconds.append(int(dict(message["headers"])[b"retry-after"]))

    async def ask_at_once(number: int) -> None:
        settings = Settings(limit_concurrency=2)  # and so one caller has one place
        middleware = AuthenticationMiddleware(wait, settings, Keys(settings))
        scope = {"type": "http", "method": "GET", "path": "/v1/fits", "headers": [], "client": ("127.0.0.1", 1)}
        first, *refused = [asyncio.create_task(middleware({**scope}, receive, send)) for _ in range(1 + number)]
        await asyncio.gather(*refused)
        over.set()
        await first

    asyncio.run(ask_at_once(2000))
    assert len(seconds) == 2000
    assert seconds == sorted(seconds)
    assert (seconds[0], seconds[-1]) == (1, 60)
    assert 19 <= seconds[399] <= 20  # twenty a second


def test_upload_over_quota_is_refused_and_not_stored(guarded: Guarded, data: bytes) -> None:
    server = guarded.server
    header = guarded.new_key("full", stored_mb=74)  # room for two files of 35.0 MB
    before = set(server.files())

    def upload(content: bytes) -> httpx.Response:
        return server.http.post("/v1/measurements", content=content, headers=header)

    files = variants(data, 6)
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
