"""What an operator sees of the service: request ids, the log, the metrics and under which labels."""

import io
import json
import logging
import os
import re
import signal
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from dsbrdf.engines import Fault, FitLimits, Processes
from dsbrdf_service.log import LineFormatter, LogWriter, bind
from dsbrdf_service.storage.database import FILE_NAME
from dsbrdf_service.storage.schema import checksum
from tests.support.processes import wait_until
from tests.support.server import ENDLESS, QUICK, Server, StartServer, assert_problem

pytestmark = pytest.mark.slow

SECRET = "s3cret-S3CRET_s3cret-S3CRET_s3cret-S3CRET_x"
KEY = f"dsbrdf_0123456789ab_{SECRET}"


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A service whose log and metrics nobody else fills."""
    with Server.running(tmp_path_factory.mktemp("watched") / "data", workers="1") as running:
        yield running


def lines(server: Server) -> list[dict[str, Any]]:
    """Every line of the log; all of them have to be JSON."""
    return [json.loads(line) for line in server.log.read_text().splitlines()]


def lines_of(server: Server, request_id: str, requests: int = 1) -> list[dict[str, Any]]:
    """The lines of a request; the last one is written when the client has its answer already."""

    def found() -> list[dict[str, Any]]:
        return [line for line in lines(server) if line.get("request_id") == request_id]

    wait_until(lambda: sum(line["event"] == "request" for line in found()) == requests)
    return found()


@pytest.mark.parametrize("given", ["abc", "A-b_c.9", "x" * 64, "", "x" * 65, "a b", "a;b", 'a"b', "\u00e9"])
def test_valid_request_id_is_kept_and_any_other_replaced(watched: Server, given: str) -> None:
    answer = watched.http.get("/health/live", headers=[(b"X-Request-ID", given.encode("latin-1"))])
    (told,) = answer.headers.get_list("x-request-id")
    assert told == given if given in ("abc", "A-b_c.9", "x" * 64) else re.fullmatch("[0-9a-f]{16}", told)


def test_every_response_has_a_unique_request_id(watched: Server) -> None:
    paths = ("/health/live", "/nowhere", "/v1/fits?limit=x", f"/v1/measurements/{'0' * 64}")
    answers = [watched.http.request(method, path) for path in paths for method in ("GET", "PUT", "HEAD", "GET")]
    assert {answer.status_code for answer in answers} == {200, 404, 405, 422}
    assert len({answer.headers["x-request-id"] for answer in answers}) == len(answers)


def test_request_is_logged_in_one_line(watched: Server) -> None:
    watched.http.get("/nowhere?secret=1", headers={"X-Request-ID": "one-line"})
    (line,) = lines_of(watched, "one-line")
    assert line["event"] == "request"
    assert (line["method"], line["path"], line["status"], line["level"]) == ("GET", "/nowhere", 404, "info")
    assert line["client"] == "127.0.0.1"
    assert 0 < line["seconds"] < 30
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d+Z", line["time"])


def test_line_is_short_however_long_the_path_is(watched: Server) -> None:
    for path in ("/" + "x" * 60_000, "/" + "x" * 8000, "/v1/fits/" + "%01" * 8000):
        assert watched.http.get(path, headers={"X-Request-ID": "long-path"}).status_code in (431, 404)
    for line in lines_of(watched, "long-path", 3):
        assert line["path"].endswith(" characters)")
        assert len(json.dumps(line)) < 5000


def test_successful_reads_are_logged_only_on_request(watched: Server, own_server: StartServer) -> None:
    talkative = own_server(log_level="debug")
    for server, expected in ((watched, 0), (talkative, 1)):
        server.http.get("/v1/fits", headers={"X-Request-ID": "quiet"})
        server.http.get("/nowhere", headers={"X-Request-ID": "after"})  # its line follows those of the first
        assert len(lines_of(server, "after")) == 1
        assert len(lines_of(server, "quiet", expected)) == expected


def test_request_cannot_inject_log_lines(watched: Server) -> None:
    forged = '/v1/x%0A{"event":"forged"}%0D%0A%1B[2J%E2%80%A8end'
    begin = len(watched.log.read_text().splitlines())
    assert watched.http.get(forged, headers={"User-Agent": "a\tb"}).status_code == 404
    assert watched.http.get("/last-line").status_code == 404
    wait_until(lambda: "/last-line" in watched.log.read_text())
    added = watched.log.read_text().splitlines()[begin:]
    assert len(added) == 2
    assert "forged" in added[0]
    assert not re.search("[\x00-\x1f\x7f-\x9f]", added[0])


def test_api_key_is_never_logged(watched: Server) -> None:
    headers = {"X-Request-ID": "with-key"}
    watched.http.get(f"/v1/{KEY}?key={KEY}", headers={**headers, "Authorization": f"Bearer {KEY}"})
    watched.http.get(f"/v1/fits/Bearer%20{SECRET}%20Basic%20{SECRET}", headers=headers)
    watched.http.get(f"/v1/{KEY}", headers={"X-Request-ID": KEY})
    watched.http.get(f"/v1/x{KEY}/_{KEY}", headers=headers)
    for length in range(440, 500, 3):  # cut somewhere in the key
        watched.http.get(f"/v1/{'x' * length}{KEY}{KEY}", headers=headers)
    assert len(lines_of(watched, "with-key", 23)) == 23
    text = watched.log.read_text()
    assert "dsbrdf_0123456789ab_" in text  # whose key it was may be told
    assert SECRET[-8:] not in text
    assert SECRET[:3] not in text


def test_log_lines_of_a_fit_carry_its_request_id(watched: Server, data: bytes) -> None:
    options, headers = {**QUICK, "em_iterations": 4}, {"X-Request-ID": "wants-fit"}
    fit = watched.http.post("/v1/fits", params=options, content=data, headers=headers).json()
    assert fit["status"] == "succeeded"
    told = {line["event"]: line for line in lines_of(watched, "wants-fit")}
    assert told["the fit has succeeded"]["fit"] == fit["id"]
    assert told["request"]["status"] == 201


def test_internal_error_is_logged_once(own_server: StartServer, data: bytes) -> None:
    server = own_server()
    fit = server.http.post("/v1/fits", params=QUICK, content=data).json()["id"]
    with closing(sqlite3.connect(server.data_dir / FILE_NAME)) as database, database:
        database.execute("UPDATE fits SET result = '5', metrics = NULL, checksum = ?", (checksum(None, b"5"),))
    answer = server.http.get(f"/v1/fits/{fit}/components", headers={"X-Request-ID": "broken"})
    assert assert_problem(answer, 500, "internal") == "The service failed at this request; its log says why."
    assert answer.headers["x-request-id"] == "broken"
    with_reason, request = lines_of(server, "broken")
    assert (with_reason["level"], request["level"]) == ("error", "error")
    assert "TypeError" in with_reason["exception"]
    assert sum("Traceback" in line for line in server.log.read_text().splitlines()) == 1


def test_output_of_fit_processes_is_in_the_log() -> None:
    stream, processes = io.StringIO(), Processes(1, FitLimits())
    handler, of_processes = logging.StreamHandler(stream), logging.getLogger("dsbrdf.engines.engine")
    handler.setFormatter(LineFormatter())
    of_processes.addHandler(handler)
    bind("fit", "one")
    fault = processes.call(divmod, 1, on_progress=print).result()  # A number cannot be divided by a function.
    of_processes.removeHandler(handler)
    processes.close()
    assert isinstance(fault, Fault)
    told = json.loads(stream.getvalue())
    assert (told["level"], told["fit"]) == ("error", "one")
    assert "TypeError: unsupported operand" in told["exception"]


def metrics(server: Server) -> dict[tuple[str, ...], float]:
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
    before, begin = metrics(watched), time.monotonic()
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
    assert more("dsbrdf_request_seconds_sum", "GET", route) < time.monotonic() - begin
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


def test_fits_and_uploads_are_counted_and_timed(own_server: StartServer, data: bytes) -> None:
    server = own_server(workers="1", fit_attempts="2")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    running = server.submit(sha256, prefer="respond-async", **ENDLESS).json()["id"]
    server.until_running(running)
    waiting = server.submit(sha256, prefer="respond-async", n_lobes=1).json()["id"]
    (worker,) = server.workers()
    os.kill(worker, signal.SIGKILL)
    now = metrics(server)
    assert now["dsbrdf_fits", "accepted"] + now["dsbrdf_fits", "running"] == 2
    wait_until(lambda: metrics(server)["dsbrdf_fit_retries_total",] == 1)
    server.until_running(running)
    assert server.http.delete(f"/v1/fits/{running}").json()["status"] == "cancelled"
    assert server.http.get(f"/v1/fits/{waiting}?wait=60").json()["status"] == "succeeded"
    wait_until(lambda: metrics(server)["dsbrdf_requests_in_progress",] == 1)
    after = metrics(server)
    assert after["dsbrdf_fits", "succeeded"] == after["dsbrdf_fits", "cancelled"] == 1
    assert after["dsbrdf_fits", "accepted"] == after["dsbrdf_fits", "failed"] == 0
    assert after["dsbrdf_fit_retries_total",] == 1
    assert after["dsbrdf_stored_bytes",] == len(data)
    assert after["dsbrdf_stage_seconds_count", "upload"] == 1
    assert after["dsbrdf_stage_seconds_count", "waiting"] == 2
    assert after["dsbrdf_stage_seconds_count", "fitting"] == 3  # one of them was lost, and one cancelled
    assert after["dsbrdf_requests_in_progress",] == 1


def test_lines_that_are_dropped_are_counted() -> None:
    read, write = os.pipe()
    handler = LogWriter(write)
    handler.setFormatter(LineFormatter())
    for number in range(10_000):
        handler.emit(logging.makeLogRecord({"msg": "line %d", "args": (number,), "levelname": "INFO"}))
    content = bytearray()
    with open(read, "rb", buffering=0) as pipe:  # noqa: PTH123 (a descriptor)

        def told() -> int:
            content.extend(pipe.read(1 << 16))
            events = [json.loads(line)["event"] for line in content.splitlines() if line.endswith(b"}")]
            dropped = [int(event.split()[0]) for event in events if event.endswith("were dropped: nobody read it.")]
            return len(events) - len(dropped) + sum(dropped)

        wait_until(lambda: told() >= 10_000, 60)
    os.close(write)


def test_line_at_a_terminal_is_one_line_of_words() -> None:
    record = logging.makeLogRecord({"msg": 'two\nlines "x"', "levelname": "INFO", "name": "dsbrdf", "route": "a\x1bb"})
    line = LineFormatter(in_words=True).format(record)
    assert re.fullmatch(r'[\dT:.-]+Z info two\\nlines \\"x\\" logger=dsbrdf .*route=a\\u001bb', line)
