"""How fast the service is on this machine: one row for each target, with the target and the measured value.

The service is the real one, in a process of its own on the loopback address. Rates are medians of several runs, and
what is compared with something (FastAPI alone, the library) alternates with it in the same run. The exit code is 1 if
a row is missed; other work on the machine makes rows miss.
"""

import argparse
import io
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple
from functools import partial
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlencode

import numpy as np

from benchmarks.durability_series.harness import Harness
from benchmarks.http_load import PeakMemory, Rate, Row, at_once, get_repeatedly, load_generator, post, program
from dsbrdf import write_merl
from dsbrdf.data import FILE_SIZE, synthetic_measurement
from dsbrdf.output import from_json
from tests.support.server import Server

CONNECTIONS = 16
POINTS = 100_000
UPLOADS = 32

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


class Place(NamedTuple):
    """What a row is measured with: a running service, and a measurement that it has stored."""

    harness: Harness
    server: Server
    runs: int

    @property
    def address(self) -> str:
        """URL of the service."""
        return str(self.server.http.base_url).rstrip("/")

    def fitted(self) -> str:
        """Address of a default fit of the measurement."""
        status, body = post(f"{self.address}/v1/fits?", [self.harness.measurement.read_bytes()], _RAW)
        assert status in (200, 201), body
        return f"{self.address}/v1/fits/{json.loads(body)['id']}"


def gets(place: Place) -> list[Row]:
    """Measure values of one point, compared with FastAPI alone with and without parameters, and while fits run."""
    service = f"{place.fitted()}/brdf?{_POINT}", place.server.process.pid
    command = [sys.executable, "-m", "benchmarks.fastapi_baseline"]
    with program(command, place.harness.folder / "baseline.log") as (address, pid):
        same = f"{address}{service[0].removeprefix(place.address)}", pid
        targets = (service, same, (f"{address}/values", pid))
        for target, server in targets:
            get_repeatedly(target, CONNECTIONS, 1.0, server)
        runs = [[get_repeatedly(url, CONNECTIONS, 3.0, server) for url, server in targets] for _ in range(place.runs)]
    ours, *theirs = zip(*runs, strict=True)
    rows = []
    for known, said in zip(theirs, ("the same parameters", "no parameters"), strict=True):
        ratio = statistics.median(one.processor_us / our.processor_us for one, our in zip(known, ours, strict=True))
        asked = f"GET of BRDF values, {CONNECTIONS} connections, processor time: >= 0.7 of FastAPI alone with {said}"
        rows.append(Row(asked, f"{ratio:.2f}: {_shown(ours)}; FastAPI alone {_shown(known)}", ratio >= 0.7))
    with _fits_running(place):
        busy = [get_repeatedly(service[0], CONNECTIONS, 3.0, service[1]) for _ in range(place.runs)]
    p99 = statistics.median(rate.p99 for rate in busy)
    return [*rows, Row("the same with 2 fits running: p99 <= 150 ms", _shown(busy), p99 <= 150.0)]


def npy(place: Place) -> list[Row]:
    """Measure a hundred thousand points in one request, compared with the call of the library."""
    fit = place.fitted()
    model, _ = from_json(place.server.http.get(f"{fit}/export?format=json").raise_for_status().text)
    degrees = np.random.default_rng(0).uniform(0.0, 90.0, (POINTS, 2))
    theta_half, theta_diff = np.radians(degrees.T)
    buffer = io.BytesIO()
    np.save(buffer, degrees)
    body = buffer.getvalue()
    here, there = [], []
    for _ in range(place.runs + 1):  # the first does not count
        here.append(_timed(partial(model.evaluate, theta_half, theta_diff)))
        begin = time.perf_counter()
        status, answer = post(f"{fit}/brdf", [body], _NPY)
        there.append(time.perf_counter() - begin)
        assert status == 200, answer[:500]
    assert np.array_equal(np.load(io.BytesIO(answer)), model.evaluate(theta_half, theta_diff))
    seconds = statistics.median(there[1:])
    ratio = statistics.median(http / call for http, call in zip(there[1:], here[1:], strict=True))
    rate = 3 * POINTS / seconds
    measured = (
        f"{rate / 1e6:.2f} million values/s ({rate / 3e6:.2f} million points/s), {ratio:.2f} times the library call "
        f"({model.n_lobes} lobes: {seconds:.3f} s, library {statistics.median(here[1:]):.3f} s)"
    )
    asked = f"POST of {POINTS:,} points as .npy: >= 1.5 million values/s, <= 1.3 times the library call"
    return [Row(asked, measured, rate >= 1.5e6 and ratio <= 1.3)]


def uploads(place: Place) -> list[Row]:
    """Measure uploads of different measurements at the same time."""
    common = memoryview(place.harness.measurement.read_bytes())[:-8]
    _upload(place, common, 0)
    rates, growths = [], []
    for run in range(place.runs):
        memory = PeakMemory(place.server.process.pid)
        first = 1 + run * UPLOADS
        seconds = at_once([partial(_upload, place, common, number) for number in range(first, first + UPLOADS)])
        rates.append(UPLOADS * FILE_SIZE / seconds / 1e6)
        growths.append(memory.growth() / (1 << 20))
    rate, growth = statistics.median(rates), max(growths)
    measured = f"{rate:.0f} MB/s ({', '.join(f'{r:.0f}' for r in rates)}), at most +{growth:.1f} MB"
    asked = f"{UPLOADS} uploads of 33 MB at once: >= 120 MB/s together, web process +32 MB at most"
    return [Row(asked, measured, rate >= 120.0 and growth <= 32.0)]


def overhead(place: Place) -> list[Row]:
    """Measure a fit with a fixed number of lobes by one request with the file, compared with the time of the library.

    That is what reading the file, fitting and writing the document take in a process of its own, once before the
    request and once after it: their mean is compared with, and how far they are apart is what the machine itself adds
    to every difference. The second row compares with the time of the very fit, as its report tells.
    """
    place.fitted()
    options = {"n_lobes": 2, "ring_lobes": 0}
    file = place.harness.folder / "variant.binary"
    beside, own, apart, library, processor = [], [], [], [], []
    for number in range(4 * place.runs):
        body = place.harness.variant(number)
        file.write_bytes(body)
        os.sync()  # the file written above is not the service's to wait for
        before, used = _library(file, options)
        used_before = _processor_seconds(place.server)
        begin = time.perf_counter()
        status, answer = post(f"{place.address}/v1/fits?{urlencode(options)}", [body], _RAW | {"Prefer": "wait=300"})
        seconds = time.perf_counter() - begin
        assert status == 201, answer
        processor.append(1e3 * (_processor_seconds(place.server) - used_before - used))
        after, _ = _library(file, options)
        exported = place.server.http.get(f"/v1/fits/{json.loads(answer)['id']}/export?format=json").raise_for_status()
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


PARTS: dict[str, Callable[[Place], list[Row]]] = {
    "gets": gets,
    "npy": npy,
    "uploads": uploads,
    "overhead": overhead,
}


@contextmanager
def _fits_running(place: Place) -> Iterator[None]:
    """Keep two default fits running, each of another cutoff, so that none is known already."""
    measurement = place.server.http.get("/v1/measurements").json()["items"][0]["sha256"]
    stopped = threading.Event()

    def fit_on(number: int) -> None:
        while not stopped.is_set():
            options = {"method": "global", "horizon_cutoff_deg": 79.0 + number * 1e-6}
            assert place.server.submit(measurement, "wait=300", **options).status_code == 201
            number += 2

    threads = [threading.Thread(target=fit_on, args=(number,)) for number in (0, 1)]
    for thread in threads:
        thread.start()
    time.sleep(0.5)
    yield
    stopped.set()
    for thread in threads:
        thread.join()


def _upload(place: Place, common: memoryview, number: int) -> None:
    """Send the measurement with another last node, which lies below the horizon."""
    body: list[bytes | memoryview] = [common, np.array([-2.0 - number], dtype="<f8").tobytes()]
    status, answer = post(f"{place.address}/v1/measurements?", body, _RAW)
    assert status == 201, answer


def _library(file: Path, options: dict[str, int]) -> tuple[float, float]:
    """Return the time, and the processor's, to read, fit and encode a file in a process of its own [s]."""
    command = [sys.executable, "-c", _LIBRARY, str(file), json.dumps(options)]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    seconds, processor = map(float, run.stdout.split())
    return seconds, processor


def _processor_seconds(server: Server) -> float:
    """Return the processor time of the web process, of its helpers and of the fits that have ended [s]."""
    fields = [Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in server.helpers()]
    of_helpers = sum(int(number) for of_one in fields for number in of_one[11:15])  # includes their children
    return server.cpu_seconds() + of_helpers / os.sysconf("SC_CLK_TCK")


def _p95_p50(milliseconds: Sequence[float]) -> str:
    p50, p95 = np.quantile(milliseconds, [0.5, 0.95])
    return f"p95 {p95:.0f} ms, p50 {p50:.0f} ms"


def _timed(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def _shown(rates: Sequence[Rate]) -> str:
    per_second, p50, p99, used = (statistics.median(values) for values in zip(*map(astuple, rates), strict=True))
    return f"{per_second:.0f}/s, p50 {p50:.1f} ms, p99 {p99:.1f} ms, {used:.0f} us"


def main(argv: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks service", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, metavar="PART", help=f"some of: {', '.join(PARTS)}")
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="runs of each rate (default: 5)")
    parser.add_argument("--file", type=Path, metavar="MERL", help="a measurement, instead of a generated one")
    arguments = parser.parse_args(argv)
    print(f"load generator: {load_generator()}; load of the machine: {os.getloadavg()[0]:.1f}")
    print("| asked | measured | |\n|---|---|---|", flush=True)
    missed = False
    for name in arguments.only or PARTS:
        with tempfile.TemporaryDirectory(prefix="dsbrdf-") as folder:
            measurement = arguments.file
            if measurement is None:
                measurement = Path(folder) / "plastic.binary"
                write_merl(measurement, synthetic_measurement(noise=0.02, seed=1))
            harness = Harness(Path(folder), measurement, random.Random(0), own_interpreter=True)
            with harness.server() as server:
                server.start()
                for row in PARTS[name](Place(harness, server, arguments.runs)):
                    print(f"| {row.asked} | {row.measured} | {'ok' if row.holds else 'missed'} |", flush=True)
                    missed |= not row.holds
    return int(missed)
