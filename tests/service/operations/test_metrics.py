"""The metrics: what is counted, and under which labels."""

import os
import signal
from collections.abc import Callable

from prometheus_client.parser import text_string_to_metric_families

from tests.support.processes import wait_until
from tests.support.server import ENDLESS, QUICK, Server


def metrics(server: Server) -> dict[tuple[str, ...], float]:
    """Samples by name and values of the labels."""
    answer = server.http.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def test_requests_are_counted_by_route(watched: Server, data: bytes) -> None:
    document = watched.http.post("/v1/fits", params=QUICK, content=data).json()
    fit, sha256 = document["id"], document["measurement"]
    before = metrics(watched)
    for theta in range(5):
        watched.http.get(f"/v1/fits/{fit}/brdf?theta_half_deg={theta}&theta_diff_deg=1")
    watched.http.get(f"/v1/fits/{fit}/brdf?theta_half_deg=100&theta_diff_deg=1")
    after = metrics(watched)
    route = "/v1/fits/{fit_id}/brdf"

    def more(*sample: str) -> float:
        return after[sample] - before.get(sample, 0.0)

    assert more("dsbrdf_requests_total", "GET", route, "200") == 5
    assert more("dsbrdf_requests_total", "GET", route, "422") == 1
    assert more("dsbrdf_request_seconds_count", "GET", route) == 6
    assert more("dsbrdf_stage_seconds_count", "evaluating") == 5
    assert not [sample for sample in after if any(fit in part or sha256 in part for part in sample)]


def test_unknown_paths_add_no_metric_labels(watched: Server) -> None:
    watched.http.get("/strange/0")
    watched.http.request("BREW", "/strange/0")
    metrics(watched)  # the first look adds its own labels
    before = metrics(watched)
    for number in range(20):
        watched.http.get(f"/strange/{number}")
        watched.http.request(f"BREW{number}", "/strange")
    after = metrics(watched)
    assert set(after) - set(before) <= {("dsbrdf_requests_total", "GET", "/metrics", "200")}
    unknown = ("dsbrdf_requests_total", "GET", "unknown", "404")
    assert after[unknown] - before[unknown] == 20


def test_fits_and_uploads_are_counted_and_timed(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server(workers="1", fit_attempts="2")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    running = server.submit(sha256, prefer="respond-async", **ENDLESS).json()["id"]
    server.until_running(running)
    waiting = server.submit(sha256, prefer="respond-async", n_lobes=1).json()["id"]
    (worker,) = server.workers()
    os.kill(worker, signal.SIGKILL)
    with server.http.stream("GET", f"/v1/fits/{waiting}/events") as stream:
        events = stream.iter_lines()  # once nobody refers to it, httpx closes the connection
        next(events)
        now = metrics(server)
    assert now["dsbrdf_event_streams",] == 1
    assert now["dsbrdf_fits", "accepted"] + now["dsbrdf_fits", "running"] == 2
    wait_until(lambda: metrics(server)["dsbrdf_fit_retries_total",] == 1)
    server.until_running(running)
    assert server.http.delete(f"/v1/fits/{running}").json()["status"] == "cancelled"
    assert server.http.get(f"/v1/fits/{waiting}?wait=60").json()["status"] == "succeeded"
    wait_until(lambda: metrics(server)["dsbrdf_event_streams",] == 0)
    wait_until(lambda: metrics(server)["dsbrdf_requests_in_progress",] == 1)
    after = metrics(server)
    assert after["dsbrdf_fits", "succeeded"] == after["dsbrdf_fits", "cancelled"] == 1
    assert after["dsbrdf_fits", "accepted"] == after["dsbrdf_fits", "failed"] == 0
    assert after["dsbrdf_fit_retries_total",] == 1
    assert after["dsbrdf_stored_bytes",] == len(data)
    assert after["dsbrdf_uploaded_bytes_total",] >= len(data)
    assert after["dsbrdf_stage_seconds_count", "upload"] == 1
    assert after["dsbrdf_stage_seconds_count", "waiting"] == 2
    assert after["dsbrdf_stage_seconds_count", "fitting"] == 2  # one of them was lost
    assert after["dsbrdf_requests_in_progress",] == 1
