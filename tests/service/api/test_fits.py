"""The main job: a measurement goes in, a fit comes out, once."""

import hashlib
import json
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import httpx
import pytest

import dsbrdf
from dsbrdf.output.serialize import model_from_dict
from tests.support.merl_files import with_value
from tests.support.models import assert_same_bits
from tests.support.processes import alive, wait_until
from tests.support.server import ENDLESS, QUICK, Server, StartServer, assert_problem
from tests.support.soak import SOAK


@pytest.mark.filterwarnings("ignore::dsbrdf.ConvergenceWarning")
def test_raw_file_is_fitted_in_one_request(server: Server, data: bytes, plastic_file: Path) -> None:
    options: dict[str, Any] = {"method": "paper", "n_lobes": 2, "em_iterations": 7}
    kind = {"Content-Type": "application/octet-stream"}
    answer = server.http.post("/v1/fits", params=options, content=data, headers=kind)
    assert answer.status_code == 201
    fit = answer.json()
    assert answer.headers["location"] == f"/v1/fits/{fit['id']}"
    assert fit["status"] == "succeeded"
    assert fit["progress"] == 1.0
    assert fit["measurement"] == hashlib.sha256(data).hexdigest()
    assert fit["options"]["n_lobes"] == 2
    assert fit["error"] is None
    assert fit["created"] <= fit["started"] <= fit["finished"]
    assert fit["created"].endswith("Z")

    expected = dsbrdf.fit(dsbrdf.read_merl(plastic_file), dsbrdf.FitOptions(method="paper", n_lobes=2, em_iterations=7))
    assert fit["metrics"] == asdict(expected.report.metrics)
    assert fit["warnings"] == [*expected.report.warnings]
    assert any("before they converged" in sentence for sentence in fit["warnings"])
    assert_same_bits(model_from_dict(fit["model"]), expected.model)
    assert [component["label"] for component in fit["components"]] == list(dsbrdf.decompose(expected).labels)


def test_concurrent_requests_with_one_file_make_one_fit(server: Server, data: bytes) -> None:
    content = with_value(data, 0.75)

    def post(_: int) -> httpx.Response:
        return httpx.post(server.http.base_url.join("/v1/fits"), params=QUICK, content=content, timeout=60)

    with ThreadPoolExecutor(3) as pool:
        answers = list(pool.map(post, range(3)))
    assert sorted(answer.status_code for answer in answers) == [200, 200, 201]
    assert len({answer.text for answer in answers}) == 1
    sha256 = answers[0].json()["measurement"]
    assert [path.stem for path in server.files() if path.stem == sha256] == [sha256]
    assert not [path for path in server.files() if path.parent.name == "tmp"]


def test_request_that_may_not_wait_long_gets_202_and_a_location(server: Server, stored: str) -> None:
    answer = server.submit(stored, prefer="respond-async", mask=0.11, **ENDLESS)
    assert answer.status_code == 202
    fit, url = answer.json(), answer.headers["location"]
    assert url == f"/v1/fits/{fit['id']}"
    assert int(answer.headers["retry-after"]) >= 1
    assert fit["status"] in ("accepted", "running")
    assert [fit[name] for name in ("components", "metrics", "warnings", "findings")] == [None, None, [], []]

    start = time.monotonic()
    same = server.submit(stored, prefer="wait=0.2, handling=lenient", mask=0.11, **ENDLESS)
    assert (same.status_code, same.json()["id"]) == (202, fit["id"])
    assert time.monotonic() - start > 0.15
    server.until_running(fit["id"])
    start = time.monotonic()
    running = server.http.get(url, params={"wait": 0.1})
    assert (running.json()["status"], int(running.headers["retry-after"]) >= 1) == ("running", True)
    assert time.monotonic() - start > 0.09
    assert_problem(server.http.get(f"{url}/components"), 409, "fit-not-finished")
    assert server.http.delete(url).json()["status"] == "cancelled"


def test_fit_is_cancelled_with_its_process_or_deleted(server: Server, stored: str) -> None:
    wait_until(lambda: not server.workers())  # Fits of other tests end.
    fit_id = server.submit(stored, prefer="respond-async", mask=0.13, **ENDLESS).json()["id"]
    url = f"/v1/fits/{fit_id}"
    server.until_running(fit_id)
    (worker,) = server.workers()
    assert_problem(server.http.delete(url, params={"only": "delete"}), 409, "fit-not-finished")
    assert server.status(fit_id) == "running"
    start = time.monotonic()
    cancelled = server.http.delete(url, params={"only": "cancel"})
    assert (cancelled.status_code, cancelled.json()) == (200, {"id": fit_id, "status": "cancelled"})
    wait_until(lambda: not alive(worker))
    if SOAK:
        assert time.monotonic() - start < 1.0
    points = server.http.get(f"{url}/brdf", params={"theta_half_deg": 1, "theta_diff_deg": 1})
    assert_problem(points, 409, "fit-without-result")
    detail = assert_problem(server.http.delete(url, params={"only": "cancel"}), 409, "fit-ended")
    assert detail == "The fit has ended as cancelled, there is nothing to cancel; only=delete deletes it."
    for wrong in ("both", ""):
        assert_problem(server.http.delete(url, params={"only": wrong}), 422, "invalid-argument")
    deleted = server.http.delete(url, params={"only": "delete"})
    assert deleted.json() == {"id": fit_id, "status": "deleted"}
    for only in ("cancel", "delete"):
        assert_problem(server.http.delete(url, params={"only": only}), 404, "not-found")


def test_event_stream_reports_progress_and_end(server: Server, stored: str) -> None:
    fit_id = server.submit(stored, prefer="respond-async", n_lobes=4, mask=0.15).json()["id"]
    with server.http.stream("GET", f"/v1/fits/{fit_id}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        lines = list(stream.iter_lines())
    names = [line.removeprefix("event: ") for line in lines if line.startswith("event: ")]
    events = [json.loads(line.removeprefix("data: ")) for line in lines if line.startswith("data: ")]
    assert names == [event["status"] for event in events]
    assert names[-1] == "succeeded"
    progress = [event["progress"] for event in events]
    assert progress == sorted(progress)
    assert progress[-1] == 1.0
    assert len({share for share in progress if 0 < share < 1}) > 3
    assert server.http.get(f"/v1/fits/{fit_id}/events").text.count("event: ") == 1
    assert_problem(server.http.get(f"/v1/fits/{'0' * 32}/events"), 404, "not-found")


def test_full_queue_refuses_requests_and_loses_none(own_server: StartServer, data: bytes) -> None:
    server = own_server(workers="1", queue_limit="2")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    first = server.submit(sha256, prefer="respond-async", **ENDLESS).json()["id"]
    server.until_running(first)
    answers = [server.submit(sha256, prefer="respond-async", n_lobes=1, em_iterations=i + 3) for i in range(6)]
    assert [answer.status_code for answer in answers] == [202] * 2 + [503] * 4
    assert [answer.json()["progress"] for answer in answers[:2]] == [0.0, 0.0]
    accepted = [answer.json()["id"] for answer in answers[:2]]
    for answer in answers[2:]:
        assert_problem(answer, 503, "queue-full")
        assert int(answer.headers["retry-after"]) >= 1
    assert server.http.delete(f"/v1/fits/{first}").json()["status"] == "cancelled"
    for fit_id in accepted:
        assert server.http.get(f"/v1/fits/{fit_id}?wait=60").json()["status"] == "succeeded"
    assert {fit["id"] for fit in server.http.get("/v1/fits").json()["items"]} == {first, *accepted}
