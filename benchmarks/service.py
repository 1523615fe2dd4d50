"""How fast the service is on this machine: one row for each target, with the target and the measured value.

The service is started as users start it. Rates are medians of several runs, and what is compared with something
(FastAPI alone, the library) alternates with it in the same run. Other work on the machine makes rows miss.
"""

import io
import json
import os
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from urllib.parse import urlencode

import numpy as np

from benchmarks.server.load import PeakMemory, Rate, at_once, get_repeatedly, post, processor_seconds, program
from benchmarks.server.runner import Place, Row, Scenario
from benchmarks.server.runner import main as run_scenarios
from dsbrdf.data import FILE_SIZE
from dsbrdf.output import from_json
from tests.support.server import Server

CONNECTIONS = 16
N_POINTS = 100_000
N_UPLOADS = 32

_POINT = "theta_half_deg=10&theta_diff_deg=30"
_NPY = {"Content-Type": "application/x-npy", "Accept": "application/x-npy"}
_RAW = {"Content-Type": "application/octet-stream"}
_LIBRARY = """
import json, sys, time, dsbrdf
from dsbrdf.engines.local import document_of
begin, used = time.perf_counter(), time.process_time()
measurement = dsbrdf.read_merl(sys.argv[1])
result = dsbrdf.fit(measurement, **json.loads(sys.argv[2]))
document_of(result)
print(time.perf_counter() - begin, time.process_time() - used)
"""


@contextmanager
def running(place: Place) -> Iterator[tuple[Server, str]]:
    """Start a service; yield it with the path of a default fit of the measurement."""
    with place.server() as server:
        server.start()
        status, body = post(_url(server, "/v1/fits?"), [place.measurement.read_bytes()], _RAW | {"Prefer": "wait=300"})
        assert status in (200, 201), body
        yield server, f"/v1/fits/{json.loads(body)['id']}"


def _url(server: Server, path: str) -> str:
    return str(server.http.base_url).rstrip("/") + path


def gets(place: Place) -> list[Row]:
    """Measure values of one point, compared with FastAPI alone with and without parameters, and while fits run."""
    baseline = [sys.executable, "-m", "benchmarks.server.fastapi_baseline"]
    with running(place) as (server, fit):
        path, pid = f"{fit}/brdf?{_POINT}", server.process.pid
        with program(baseline, place.folder / "baseline.log") as (address, baseline_pid):
            targets = (
                (_url(server, path), pid),
                (f"{address}{path}", baseline_pid),
                (f"{address}/values", baseline_pid),
            )
            for url, process in targets:
                get_repeatedly(url, CONNECTIONS, 1.0, process)
            runs = [[get_repeatedly(url, CONNECTIONS, 3.0, one) for url, one in targets] for _ in range(place.times)]
        with _fits_running(server):
            busy = [get_repeatedly(targets[0][0], CONNECTIONS, 3.0, pid) for _ in range(place.times)]
    ours, *theirs = zip(*runs, strict=True)
    rows = []
    for known, said in zip(theirs, ("the same parameters", "no parameters"), strict=True):
        ratio = statistics.median(one.processor_us / our.processor_us for one, our in zip(known, ours, strict=True))
        asked = f"GET of BRDF values, {CONNECTIONS} connections, processor time: >= 0.7 of FastAPI alone with {said}"
        rows.append(Row(asked, f"{ratio:.2f}: {_shown(ours)}; FastAPI alone {_shown(known)}", ratio >= 0.7))
    p99 = statistics.median(rate.p99 for rate in busy)
    return [*rows, Row("the same with 2 fits running: p99 <= 150 ms", _shown(busy), p99 <= 150.0)]


def npy(place: Place) -> list[Row]:
    """Measure a hundred thousand points in one request, compared with the call of the library."""
    degrees = np.random.default_rng(0).uniform(0.0, 90.0, (N_POINTS, 2))
    theta_half, theta_diff = np.radians(degrees.T)
    buffer = io.BytesIO()
    np.save(buffer, degrees)
    here, there = [], []
    with running(place) as (server, fit):
        model, _ = from_json(server.http.get(f"{fit}/export?format=json").raise_for_status().text)
        for _ in range(place.times + 1):  # the first does not count
            begin = time.perf_counter()
            expected = model.evaluate(theta_half, theta_diff)
            between = time.perf_counter()
            status, answer = post(_url(server, f"{fit}/brdf"), [buffer.getvalue()], _NPY)
            here.append(between - begin)
            there.append(time.perf_counter() - between)
            assert status == 200, answer[:500]
    assert np.array_equal(np.load(io.BytesIO(answer)), expected)
    seconds = statistics.median(there[1:])
    ratio = statistics.median(http / call for http, call in zip(there[1:], here[1:], strict=True))
    rate = 3 * N_POINTS / seconds
    measured = (
        f"{rate / 1e6:.2f} million values/s ({rate / 3e6:.2f} million points/s), {ratio:.2f} times the library call "
        f"({model.n_lobes} lobes: {seconds:.3f} s, library {statistics.median(here[1:]):.3f} s)"
    )
    asked = f"POST of {N_POINTS:,} points as .npy: >= 1.5 million values/s, <= 1.3 times the library call"
    return [Row(asked, measured, rate >= 1.5e6 and ratio <= 1.3)]


def uploads(place: Place) -> list[Row]:
    """Measure uploads of different measurements at the same time."""
    common = memoryview(place.measurement.read_bytes())[:-8]
    rates, growths = [], []
    with place.server() as server:
        server.start()
        _upload(server, common, 0)
        for run in range(place.times):
            memory = PeakMemory(server.process.pid)
            first = 1 + run * N_UPLOADS
            calls = [partial(_upload, server, common, number) for number in range(first, first + N_UPLOADS)]
            rates.append(N_UPLOADS * FILE_SIZE / at_once(calls) / 1e6)
            growths.append(memory.growth() / (1 << 20))
    rate, growth = statistics.median(rates), max(growths)
    measured = f"{rate:.0f} MB/s ({', '.join(f'{r:.0f}' for r in rates)}), at most +{growth:.1f} MB"
    asked = f"{N_UPLOADS} uploads of 33 MB at once: >= 120 MB/s together, web process +32 MB at most"
    return [Row(asked, measured, rate >= 120.0 and growth <= 32.0)]


def overhead(place: Place) -> list[Row]:
    """Measure a fit with a fixed number of lobes by one request with the file, compared with the time of the library.

    The time of reading the file, fitting and writing the document in a process of its own is measured once before the
    request and once after it: their mean is compared with, and their distance is the noise of the machine. The second
    row compares with the time that the report of the fit states.
    """
    options = {"n_lobes": 2, "ring_lobes": 0}
    file = place.folder / "variant.binary"
    beside, own, apart, library, processor = [], [], [], [], []
    with running(place) as (server, _):
        url = _url(server, f"/v1/fits?{urlencode(options)}")
        for number in range(4 * place.times):
            body = place.variant(number)
            file.write_bytes(body)
            os.sync()  # the service need not wait for the file written above
            before, used = _library(file, options)
            used_before = _processor_seconds(server)
            begin = time.perf_counter()
            status, answer = post(url, [body], _RAW | {"Prefer": "wait=300"})
            seconds = time.perf_counter() - begin
            assert status == 201, answer
            processor.append(1e3 * (_processor_seconds(server) - used_before - used))
            after, _ = _library(file, options)
            exported = server.http.get(f"/v1/fits/{json.loads(answer)['id']}/export?format=json").raise_for_status()
            own.append(1e3 * (seconds - sum(exported.json()["report"]["timings"].values())))
            beside.append(1e3 * (seconds - (before + after) / 2))
            apart.append(1e3 * abs(after - before))
            library += [before, after]
    typical = f"the library's own {statistics.median(library):.2f} s, two runs of it {_p95_p50(apart)} apart"
    return [
        Row(
            f"POST of a file, fixed number of lobes, beyond {said}: p50 <= 70 ms, p95 <= 200 ms",
            measured,
            bool((np.quantile(extra, [0.5, 0.95]) <= [70.0, 200.0]).all()),
        )
        for said, extra, measured in (
            (
                "the library's read, fit and write in a process of its own",
                beside,
                f"{_p95_p50(beside)} over {len(own)} fits; {typical}",
            ),
            ("the timings in the fit's own report", own, _p95_p50(own)),
            ("the processor time of the library", processor, _p95_p50(processor)),
        )
    ]


@contextmanager
def _fits_running(server: Server) -> Iterator[None]:
    """Keep two default fits running, each of another cutoff, so that none is known already."""
    measurement = server.http.get("/v1/measurements").json()["items"][0]["sha256"]
    stopped = threading.Event()

    def fit_on(number: int) -> None:
        while not stopped.is_set():
            options = {"method": "global", "horizon_cutoff_deg": 79.0 + number * 1e-6}
            assert server.submit(measurement, "wait=300", **options).status_code == 201
            number += 2

    threads = [threading.Thread(target=fit_on, args=(number,)) for number in (0, 1)]
    for thread in threads:
        thread.start()
    time.sleep(0.5)
    yield
    stopped.set()
    for thread in threads:
        thread.join()


def _upload(server: Server, common: memoryview, number: int) -> None:
    """Send the measurement with another last node, which lies below the horizon."""
    body: list[bytes | memoryview] = [common, np.array([-2.0 - number], dtype="<f8").tobytes()]
    status, answer = post(_url(server, "/v1/measurements?"), body, _RAW)
    assert status == 201, answer


def _library(file: Path, options: dict[str, int]) -> tuple[float, float]:
    """Return the time, and the processor's, to read, fit and encode a file in a process of its own [s]."""
    command = [sys.executable, "-c", _LIBRARY, str(file), json.dumps(options)]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    seconds, processor = map(float, run.stdout.split())
    return seconds, processor


def _processor_seconds(server: Server) -> float:
    """Return the processor time of the web process, of its helpers and of the fits that have ended [s]."""
    return server.cpu_seconds() + sum(processor_seconds(pid, with_children=True) for pid in server.helpers())


def _p95_p50(milliseconds: Sequence[float]) -> str:
    p50, p95 = np.quantile(milliseconds, [0.5, 0.95])
    return f"p95 {p95:.0f} ms, p50 {p50:.0f} ms"


def _shown(rates: Sequence[Rate]) -> str:
    per_second, p50, p99, used = (statistics.median(values) for values in zip(*rates, strict=True))
    return f"{per_second:.0f}/s, p50 {p50:.1f} ms, p99 {p99:.1f} ms, {used:.0f} us"


def main(argv: Sequence[str]) -> int:
    """Print the table."""
    scenarios = {part.__name__: Scenario(part, 5) for part in (gets, npy, uploads, overhead)}
    return run_scenarios("service", __doc__, scenarios, argv, unit="runs", own_interpreter=True)
