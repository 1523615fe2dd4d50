"""The Python client gives the library's objects and raises the library's errors."""

import hashlib
import json
import re
import time
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

import httpx
import pytest

import dsbrdf
import examples
from dsbrdf.data.rgl import RglMaterial
from dsbrdf.engines import FitTask
from dsbrdf_service.client import Client, ClientEngine, ServiceError
from dsbrdf_service.wire import canonical
from tests.support.command_line import QUICK, document, sentence
from tests.support.models import assert_same_bits, mixture, samples_table, scattered_samples
from tests.support.processes import wait_until
from tests.support.server import Guarded, Server
from tests.support.tasks import ENDLESS

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::dsbrdf.ConvergenceWarning")]
OPTIONS = dsbrdf.FitOptions(method="paper", n_lobes=2, em_iterations=8, horizon_cutoff_deg=75)


@pytest.fixture
def client(server: Server) -> Client:
    return Client(str(server.http.base_url))


def test_fit_equals_the_library_bit_for_bit(client: Client, plastic: dsbrdf.Measurement, plastic_file: Path) -> None:
    expected = dsbrdf.fit(plastic, OPTIONS)
    with client:
        for source in (plastic_file, str(plastic_file), plastic_file.read_bytes(), plastic):
            result = client.fit(source, OPTIONS)
            assert_same_bits(result.model, expected.model)
            assert result.report.metrics == expected.report.metrics
            fit = client.submit(source, OPTIONS)
            assert fit["status"] == "succeeded"
            assert fit["options"] == canonical(OPTIONS)
            assert fit["measurement"] == plastic.sha256
            assert fit["metrics"] == asdict(expected.report.metrics)


def test_client_sends_other_files_as_the_library_reads_them(
    client: Client, plastic: dsbrdf.Measurement, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "felt.csv"
    table.write_bytes(samples_table(scattered_samples(mixture(2, seed=7), 60)))
    monkeypatch.setattr(RglMaterial, "measurement", lambda _: plastic)  # A real one takes a second.
    with client:
        assert client.upload(Path(examples.__file__).with_name("satin_purple.bsdf")) == plastic.sha256
        fit = client.submit(table, dsbrdf.FitOptions(n_lobes=1, ring_lobes=0))
        assert fit["measurement"] == dsbrdf.read_samples(table).sha256
        assert client.get(fit["id"], wait=60.0)["status"] == "succeeded"
        assert fit["name"] == table.stem
        table.write_bytes(table.read_bytes().replace(b"blue", b"azure", 1))
        assert client.upload(table, dsbrdf.TableOptions(columns="blue=azure")) == fit["measurement"]


def test_client_raises_the_library_errors(client: Client, plastic: dsbrdf.Measurement, plastic_file: Path) -> None:
    with client:
        for content in (plastic_file.read_bytes()[:-1], plastic_file.read_bytes() + b"\0"):
            with pytest.raises(dsbrdf.MeasurementFormatError) as expected:
                dsbrdf.parse_merl(content)
            with pytest.raises(dsbrdf.MeasurementFormatError, match=f"^{re.escape(str(expected.value))}$"):
                client.fit(content)
        impossible = dsbrdf.FitOptions(method="paper", n_lobes=8, mask=10, horizon_cutoff_deg=1.7)
        with pytest.raises(dsbrdf.FitError) as expected_fit:
            dsbrdf.fit(plastic, impossible)
        with pytest.raises(dsbrdf.FitError, match=f"^{re.escape(str(expected_fit.value))}$"):
            client.fit(plastic, impossible)
        with pytest.raises(ServiceError, match="There is no fit") as missing:
            client.get("0" * 32)
        assert missing.value.problem["status"] == 404


def test_key_is_sent_and_refusals_are_raised(guarded: Guarded, data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    url = str(guarded.server.http.base_url)
    key = guarded.new_key("client", queued_fits=0)["Authorization"].removeprefix("Bearer ")
    with Client(url, key=key, timeout=4.9) as client:
        sha256 = client.upload(data)
        assert sha256 == hashlib.sha256(data).hexdigest()
        with pytest.raises(ServiceError, match="unfinished") as limited:
            client.submit(data)
        assert limited.value.problem["status"] == 429
    monkeypatch.setenv("DSBRDF_KEY", key)
    with Client(url) as client:
        assert client.upload(data) == sha256
    monkeypatch.setenv("DSBRDF_KEY", key[:-2])
    with Client(url) as client:
        for call in (lambda: client.upload(data), lambda: client.get("0" * 32)):
            with pytest.raises(ServiceError, match="API key") as refused:
                call()
            assert refused.value.problem["status"] == 401
            assert key[:-2] not in str(refused.value)
    monkeypatch.delenv("DSBRDF_KEY")
    with Client(url) as client, pytest.raises(ServiceError, match="API key"):
        client.upload(data)
    small = guarded.new_key("small", stored_mb=1)["Authorization"].removeprefix("Bearer ")
    with Client(url, key=small) as client, pytest.raises(ServiceError, match="stored") as full:
        client.upload(data)
    assert full.value.problem["status"] == 403
    with pytest.raises(ValueError, match="key"):
        Client(url, key="clé")


def test_client_tells_the_progress_and_gives_names(client: Client, plastic: dsbrdf.Measurement, tmp_path: Path) -> None:
    other = tmp_path / "other plastic.binary"
    dsbrdf.write_merl(other, plastic.values * 0.5)
    seen, waits = list[float](), set[str]()
    client._http.event_hooks = {"request": [lambda request: waits.add(request.url.params.get("wait", ""))]}
    with client:
        client.fit(other, OPTIONS, progress=seen.append)
        assert waits == {"", "0.5"}  # It tells the progress twice a second.
        assert client.submit(other, OPTIONS)["name"] == "other plastic"
        named = client.submit(plastic, replace(OPTIONS, mask=0.5), name="a name of its own")  # it is known, unnamed
        assert named["name"] == client.get(named["id"])["name"] == "a name of its own"
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_engine_asks_for_so_many_fits_at_once_and_is_closed_at_once(server: Server, plastic_file: Path) -> None:
    tasks = [FitTask(str(mask), plastic_file, replace(ENDLESS, mask=float(mask))) for mask in range(3)]
    progress: list[list[float]] = [[], [], []]
    with closing(ClientEngine(str(server.http.base_url), 2)) as engine:
        fits = [engine.submit(task, told.append) for task, told in zip(tasks, progress, strict=True)]
        wait_until(lambda: [*map(bool, progress)] == [True, True, False])
    assert all(fit.done() for fit in fits)
    assert [*map(bool, progress)] == [True, True, False]
    for unfinished in server.http.get("/v1/fits?limit=100").json()["items"]:
        if unfinished["status"] in ("accepted", "running"):
            server.http.delete(f"/v1/fits/{unfinished['id']}")


@pytest.fixture
def slept(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """How long the client has slept each time, in no time."""
    seconds: list[float] = []
    monkeypatch.setattr(time, "sleep", seconds.append)
    return seconds


def upload(timeout: float, *answers: tuple[int, str | None]) -> list[str]:
    """Upload a measurement to a service with prepared statuses and Retry-After; return the methods of the requests."""
    prepared, asked = list(answers), list[str]()

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.method)
        assert request.method == "GET" or request.read() == b"measurement"
        status, retry_after = prepared.pop(0)
        headers = {} if retry_after is None else {"Retry-After": retry_after}
        return httpx.Response(status, headers=headers, json={"detail": f"refused with {status}"})

    client = Client(timeout=timeout)
    assert (client._http.timeout.read or 0.0) >= 20.0  # A request waits for a fit as long as this.
    client._http = httpx.Client(base_url="http://service", transport=httpx.MockTransport(answer))
    assert client.upload(b"measurement") == hashlib.sha256(b"measurement").hexdigest()
    return asked


def test_measurement_that_the_service_has_is_not_sent() -> None:
    assert upload(0.0, (304, None)) == ["GET"]


def test_request_is_repeated_after_the_time_that_the_service_names(slept: list[float]) -> None:
    asked = upload(6.0, (429, "2"), (404, None), (503, "5"), (429, "1"), (201, None))
    assert slept == [2.0, 5.0, 1.0]
    assert asked == ["GET"] * 2 + ["POST"] * 3


def test_pause_of_zero_seconds_does_not_repeat_a_request_without_end(slept: list[float]) -> None:
    with pytest.raises(ServiceError, match="refused with 503"):
        upload(2.0, *[(503, "0")] * 3)
    assert slept == [1.0, 1.0]


@pytest.mark.parametrize("content", ["<p>Dienst nicht verfügbar</p>".encode("latin-1"), b'"bad gateway"', b"null"])
def test_answers_of_a_proxy_become_service_errors(content: bytes) -> None:
    client = Client()
    answer = httpx.MockTransport(lambda _: httpx.Response(502, content=content))
    client._http = httpx.Client(base_url="http://service", transport=answer)
    with pytest.raises(ServiceError, match="502 Bad Gateway"):
        client.get("0" * 32)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (httpx.ConnectTimeout("timed out"), "nothing answers at http://service: is a service running there"),
        (httpx.ReadError(""), "the request to http://service failed: ReadError"),
    ],
)
def test_lost_connection_is_a_connection_error(error: Exception, said: str) -> None:
    def silence(_: httpx.Request) -> httpx.Response:
        raise error

    client = Client()
    client._http = httpx.Client(base_url="http://service", transport=httpx.MockTransport(silence))
    with pytest.raises(ConnectionError, match=said):
        client.get("0" * 32)


@pytest.mark.parametrize(
    "answer",
    [
        (429, "7"),  # more than the time that is left
        (429, None),  # without an end
        (503, "soon"),
        (507, "1"),  # it takes someone to free the disk
        (401, None),
    ],
)
def test_request_is_not_repeated_beyond_reason(slept: list[float], answer: tuple[int, str | None]) -> None:
    with pytest.raises(ServiceError, match=f"refused with {answer[0]}") as error:
        upload(12.0, (404, None), (429, "6"), answer)
    assert error.value.problem["status"] == answer[0]
    assert slept == [6.0]


def test_fit_of_the_command_on_a_server_is_the_fit_here(
    guarded: Guarded, plastic_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = ["--url", str(guarded.server.http.base_url)]
    assert "the environment variable DSBRDF_KEY" in sentence("fit", plastic_file, *address)
    monkeypatch.setenv("DSBRDF_KEY", guarded.alice["Authorization"].removeprefix("Bearer "))
    there = document("fit", plastic_file, "--json", "-o", tmp_path, *address, *QUICK)
    assert there["model"] == document("fit", plastic_file, "--json", "-o", tmp_path / "here", *QUICK)["model"]
    assert json.loads((tmp_path / "plastic.json").read_text())["model"] == there["model"]
    no_measurement = tmp_path / "cut.binary"
    no_measurement.write_bytes(plastic_file.read_bytes()[:1000])
    assert "1000" in sentence("fit", no_measurement, *address)
