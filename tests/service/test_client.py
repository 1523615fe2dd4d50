"""The Python clients give the library's objects and raise the library's errors."""

import asyncio
import inspect
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import httpx
import numpy as np
import pytest

import dsbrdf
from service.client import AccessError, AsyncClient, AsyncFit, Client, Fit, LimitError, ServiceError
from service.client_requests import Requests
from service.wire.fit_options import canonical, from_wire, to_wire
from tests.support.guarded import Guarded
from tests.support.models import assert_same_bits
from tests.support.server import ENDLESS, Server

pytestmark = pytest.mark.filterwarnings("ignore::dsbrdf.ConvergenceWarning")
OPTIONS = dsbrdf.FitOptions(method="paper", n_lobes=2, em_iterations=8, horizon_cutoff=float(np.radians(75)))


@pytest.fixture
def client(server: Server) -> Client:
    """A client of the shared service."""
    return Client(str(server.http.base_url))


def test_client_fit_equals_the_library_bit_for_bit(
    client: Client, plastic: dsbrdf.Measurement, plastic_file: Path
) -> None:
    expected = dsbrdf.fit(plastic, OPTIONS)
    with client:
        for source in (plastic_file, str(plastic_file), plastic_file.read_bytes(), plastic):
            fit = client.fit(source, OPTIONS)
            assert fit.status == "succeeded"
            assert to_wire(fit.options) == canonical(OPTIONS)
            assert fit.measurement == plastic.sha256
            assert_same_bits(fit.model, expected.model)
            assert fit.report is not None
            assert fit.report.metrics == expected.report.metrics
            assert fit.metrics == asdict(expected.report.metrics)
        assert_same_bits(fit.components.guide, dsbrdf.decompose(expected).guide)
        assert fit.components.labels == dsbrdf.decompose(expected).labels
        for component in fit.components:
            same = dsbrdf.decompose(expected)[component.label]
            np.testing.assert_array_equal(component.evaluate(0.1, 0.4), same.evaluate(0.1, 0.4))
        back = client.measurement(fit.measurement)
        np.testing.assert_array_equal(back.stored, plastic.stored)


def test_client_reports_progress(client: Client, plastic: dsbrdf.Measurement) -> None:
    seen: list[float] = []
    with client:
        client.fit(plastic, dsbrdf.FitOptions(method="paper", n_lobes=8, mask=0.31), progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_client_raises_the_library_errors(client: Client, plastic: dsbrdf.Measurement, plastic_file: Path) -> None:
    with client:
        for content in (b"", plastic_file.read_bytes()[:-1], plastic_file.read_bytes() + b"\0"):
            with pytest.raises(dsbrdf.MeasurementFormatError) as expected:
                dsbrdf.parse_merl(content)
            with pytest.raises(dsbrdf.MeasurementFormatError) as raised:
                client.fit(content)
            assert str(raised.value) == str(expected.value)
        impossible = dsbrdf.FitOptions(method="paper", n_lobes=8, mask=10, horizon_cutoff=0.03)
        with pytest.raises(dsbrdf.FitError) as expected_fit:
            dsbrdf.fit(plastic, impossible)
        with pytest.raises(dsbrdf.FitError) as raised_fit:
            client.fit(plastic, impossible)
        assert str(raised_fit.value) == str(expected_fit.value)
        with pytest.raises(ServiceError, match="There is no fit") as missing:
            client.get("0" * 32)
        assert missing.value.problem["status"] == 404


def test_client_waits_for_lists_and_deletes_fits(own_server: Callable[..., Server], plastic_file: Path) -> None:
    server = own_server(workers="1")
    with Client(str(server.http.base_url)) as client:
        first = client.submit(plastic_file, from_wire(ENDLESS))
        second = client.submit(plastic_file, OPTIONS)
        assert not first.ended
        assert [fit.id for fit in client.fits()] == [second.id, first.id]
        client.delete(first.id)
        assert client.get(first.id).status == "cancelled"
        client.delete(first.id)
        assert client.get(second.id, wait=30).status == "succeeded"
        assert [fit.id for fit in client.fits()] == [second.id]
        client.delete_measurement(second.measurement)
        with pytest.raises(ServiceError, match="no measurement"):
            client.measurement(second.measurement)


def test_client_names_an_unreachable_service() -> None:
    with Client("http://127.0.0.1:9") as client:
        start = time.monotonic()
        with pytest.raises(ServiceError, match=r"127\.0\.0\.1:9 is not ready"):
            client.wait_until_ready(0.3)
        assert time.monotonic() - start < 10  # of the 30 s that it waits by itself


def test_client_sends_its_key_and_raises_what_was_refused(
    guarded: Guarded, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = str(guarded.server.http.base_url)
    key = guarded.new_key("client", queued_fits=0)["Authorization"].removeprefix("Bearer ")
    with Client(url, key=key, patience=4.9) as client:
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


def test_async_client_has_the_methods_of_the_client() -> None:
    def signatures(client: type) -> dict[str, list[str]]:
        methods = inspect.getmembers(client, inspect.isfunction)
        return {name: [*inspect.signature(method).parameters] for name, method in methods if name[0] != "_"}

    assert signatures(AsyncClient) == signatures(Client)
    assert inspect.signature(AsyncClient).parameters.keys() == inspect.signature(Client).parameters.keys()
    assert {name for name in vars(Fit) if name[0] != "_"} == {name for name in vars(AsyncFit) if name[0] != "_"}


def test_async_client_gives_what_the_client_gives(server: Server, plastic: dsbrdf.Measurement, tmp_path: Path) -> None:
    url = str(server.http.base_url)
    other = tmp_path / "other plastic.binary"
    dsbrdf.write_merl(other, plastic.values * 0.5)
    seen: list[float] = []

    async def converse() -> None:
        async with AsyncClient(url) as client:
            await client.wait_until_ready()
            fit, of_file = await asyncio.gather(
                client.fit(plastic, OPTIONS, progress=seen.append), client.fit(other, OPTIONS)
            )
            with Client(url) as blocking:
                expected = blocking.get(fit.id)
                assert_same_bits(await fit.model(), expected.model)
                assert await fit.report() == expected.report
                assert (await fit.components()).labels == expected.components.labels
                assert_same_bits((await fit.components()).guide, expected.components.guide)
                cached = {"_result", "components"}
                assert vars(fit).keys() == vars(expected).keys() - cached
            assert of_file.name == "other plastic"
            assert [one.id async for one in client.fits(name="other plastic")] == [of_file.id]
            assert (await client.get(of_file.id)).metrics == of_file.metrics
            await client.delete(of_file.id)
            assert [one async for one in client.fits(name="other plastic")] == []
            np.testing.assert_array_equal((await client.measurement(of_file.measurement)).stored, plastic.stored * 0.5)
            await client.delete_measurement(of_file.measurement)
            with pytest.raises(ServiceError, match="no measurement"):
                await client.measurement(of_file.measurement)
            with pytest.raises(dsbrdf.MeasurementFormatError, match="empty"):
                await client.submit(b"")

    asyncio.run(converse())
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


class Answers:
    """A transport that gives prepared responses and notes what is asked, and how long it is told to wait."""

    address = httpx.URL("http://service")

    def __init__(self, *answers: httpx.Response) -> None:
        self.answers, self.asked, self.slept = list(answers), list[str](), list[float]()

    async def request(self, method: str, url: str, **arguments: object) -> httpx.Response:
        self.asked.append(f"{method} {url.removeprefix('/v1/')}")
        body = arguments.get("content")
        if body is not None:
            assert isinstance(body, Iterator)
            assert b"".join(body) == b"measurement"
        return self.answers.pop(0)

    async def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)

    async def digest(self, source: object) -> str:
        return "sha256"

    def content(self, source: object) -> Iterator[bytes]:
        assert isinstance(source, bytes)
        return iter([source])


def refused(status: int, retry_after: str | None = None) -> httpx.Response:
    headers = {} if retry_after is None else {"Retry-After": retry_after}
    return httpx.Response(status, headers=headers, json={"detail": f"refused with {status}"})


def uploaded(transport: Answers, patience: float) -> str:
    return asyncio.run(Requests(transport, Fit, patience).upload(b"measurement"))


def test_measurement_that_the_service_has_is_not_sent() -> None:
    transport = Answers(httpx.Response(200))
    assert uploaded(transport, 0.0) == "sha256"
    assert transport.asked == ["HEAD measurements/sha256"]


def test_request_is_repeated_after_the_time_that_the_service_names() -> None:
    transport = Answers(
        refused(429, "2"), httpx.Response(404), refused(503, "5"), refused(429, "1"), httpx.Response(201)
    )
    assert uploaded(transport, 6.0) == "sha256"
    assert transport.slept == [2.0, 5.0, 1.0]
    assert transport.asked == ["HEAD measurements/sha256"] * 2 + ["POST measurements"] * 3


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (refused(429, "7"), LimitError),  # more than the patience that is left
        (refused(429), LimitError),  # without an end
        (refused(503, "soon"), ServiceError),
        (refused(507, "1"), ServiceError),  # it takes someone to free the disk
        (refused(401), AccessError),
    ],
)
def test_request_is_not_repeated_beyond_reason(answer: httpx.Response, error: type[ServiceError]) -> None:
    transport = Answers(httpx.Response(404), refused(429, "6"), answer)
    with pytest.raises(error, match=f"refused with {answer.status_code}"):
        uploaded(transport, 12.0)
    assert transport.slept == [6.0]
