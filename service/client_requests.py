"""What both clients of the service send, written once: coroutines over a `Transport`.

The transport of the blocking client never waits for an event loop, so that its coroutines end in one step.
"""

import hashlib
import json
import time
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Coroutine, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BufferedReader, BytesIO
from os import PathLike
from pathlib import Path
from typing import Any, Generic, Literal, Protocol, TypeVar

import httpx

from dsbrdf import (
    DSBRDF,
    Decomposition,
    FitError,
    FitOptions,
    FitReport,
    InvalidArgumentError,
    Measurement,
    MeasurementFormatError,
)
from dsbrdf.data.merl import encode_merl, parse_merl
from dsbrdf.output.serialize import from_json
from service.wire.fit_options import from_wire, to_wire
from service.wire.names import check_name

Source = str | PathLike[str] | bytes | Measurement
Progress = Callable[[float], None]
Removal = Literal["cancel", "delete"]
Loaded = tuple[DSBRDF, FitReport | None]
"""The model of a fit, and its report."""

POLL = 20.0
"""Time that one request waits for a fit [s]."""
_PROGRESS_POLL = 0.5
_READY_POLL = 0.1
_CHUNK = 1 << 20
_REFUSED_FOR_NOW = (429, 503)
_WITHOUT_BODY = {401: "The service wants a valid API key.", 429: "The API key has made too many requests."}
_LIBRARY_ERRORS: dict[str, type[Exception]] = {
    "urn:dsbrdf:problem:measurement-format": MeasurementFormatError,
    "urn:dsbrdf:problem:measurement-too-large": MeasurementFormatError,
    "urn:dsbrdf:problem:invalid-argument": InvalidArgumentError,
    "urn:dsbrdf:problem:fit-impossible": FitError,
}


class ServiceError(Exception):
    """The service could not do what was asked, for a reason other than the measurement or the options.

    `problem` is the problem document, or what is known of the fault under the same names.
    """

    def __init__(self, problem: Mapping[str, Any]) -> None:
        super().__init__(problem.get("detail") or problem.get("title") or "the service failed")
        self.problem = dict(problem)


class AccessError(ServiceError):
    """The service wants an API key, or does not take the one that was sent."""


class LimitError(ServiceError):
    """The key has reached its rate of requests, its unfinished fits or its stored bytes.

    `retry_after` is the time after which it is worth asking again [s]; None if waiting does not help.
    """

    def __init__(self, problem: Mapping[str, Any], retry_after: float | None) -> None:
        super().__init__(problem)
        self.retry_after = retry_after


@dataclass(frozen=True)
class FitState:
    """The state of a fit of the service when it was asked for.

    Attributes
    ----------
    id, status : str
    progress : float
        Finished share, 0 to 1.
    measurement : str
        The sha256 of the measurement.
    name : str or None
    options : FitOptions
    metrics : dict or None
        As in the library's report, once the fit has succeeded.
    error : dict or None
        Origin, type and message if it has failed.
    """

    id: str
    status: str
    progress: float
    measurement: str
    name: str | None
    options: FitOptions
    metrics: dict[str, float | None] | None
    error: dict[str, str] | None
    _load: Callable[[str], Coroutine[Any, Any, Loaded]] = field(repr=False, compare=False)
    _decompose: Callable[[str, DSBRDF], Coroutine[Any, Any, Decomposition]] = field(repr=False, compare=False)

    @property
    def ended(self) -> bool:
        """Whether the fit is over, well or not."""
        return self.status not in ("accepted", "running")


_Fit = TypeVar("_Fit", bound=FitState)


class Transport(Protocol):
    """How requests are sent and time passes."""

    address: httpx.URL

    def request(self, method: str, url: str, **arguments: Any) -> Awaitable[httpx.Response]:
        """Send a request and return its response."""

    def sleep(self, seconds: float) -> Awaitable[None]:
        """Wait."""

    def digest(self, source: bytes | str | PathLike[str]) -> Awaitable[str]:
        """Return what `sha256_of` does."""

    def content(self, source: bytes | str | PathLike[str]) -> Iterator[bytes] | AsyncIterator[bytes]:
        """Return the bytes of a file in parts, as a request's body."""


class Requests(Generic[_Fit]):
    """The conversation with a service; `Client` describes the methods.

    Parameters
    ----------
    transport : Transport
    kind : type
        Class of the fits.
    patience : float
        Longest time that a request which is refused for now is repeated [s].
    """

    def __init__(self, transport: Transport, kind: type[_Fit], patience: float) -> None:
        self._transport, self._kind, self._patience = transport, kind, patience

    async def fit(
        self,
        measurement: Source,
        options: FitOptions | None = None,
        *,
        name: str | None = None,
        progress: Progress | None = None,
    ) -> _Fit:
        """Fit a measurement and return when the fit has succeeded, as `Client.fit`."""
        fit = await self.submit(measurement, options, name=name)
        while not fit.ended:
            if progress is not None:
                progress(fit.progress)
            fit = await self.get(fit.id, wait=POLL if progress is None else _PROGRESS_POLL)
        if fit.status == "succeeded":
            if progress is not None:
                progress(1.0)
            return fit
        error = fit.error or {"origin": "system", "type": "Cancelled", "message": "The fit was cancelled."}
        if error["origin"] == "input":
            raise FitError(error["message"])
        raise ServiceError({**error, "title": error["type"], "detail": error["message"]})

    async def submit(self, measurement: Source, options: FitOptions | None = None, *, name: str | None = None) -> _Fit:
        """Ask for a fit without waiting for it; parameters and errors as `fit`."""
        sha256 = await self.upload(measurement, name=name)
        document = {"measurement": sha256, "options": to_wire(options or FitOptions())}
        asynchronous = {"Prefer": "respond-async"}
        answer = await self._call("POST", "/v1/fits", json=document, headers=asynchronous, params=_query(name))
        return self._fit(answer.json())

    async def get(self, fit_id: str, *, wait: float = 0.0) -> _Fit:
        """Return a fit, after at most `wait` seconds or when it has ended."""
        return self._fit((await self._call("GET", f"/v1/fits/{fit_id}", params={"wait": wait})).json())

    async def fits(self, *, name: str | None = None) -> AsyncGenerator[_Fit, None]:
        """Yield the service's fits, or those of one name, newest first."""
        url: str | None = str(httpx.URL("/v1/fits", params=_query(name)))
        while url is not None:
            page = await self._call("GET", url)
            for document in page.json()["items"]:
                yield self._fit(document)
            url = page.links.get("next", {}).get("url")

    async def delete(self, fit_id: str, *, only: Removal | None = None) -> str:
        """Cancel an unfinished fit, or delete one that has ended, as `Client.delete`."""
        params = {} if only is None else {"only": only}
        answer = await self._call("DELETE", f"/v1/fits/{fit_id}", params=params)
        return str(answer.json()["status"])

    async def upload(self, measurement: Source, *, name: str | None = None) -> str:
        """Make sure that the service has a measurement, and return its sha256, as `Client.upload`."""
        name = name or _own_name(measurement)
        source = encode_merl(measurement) if isinstance(measurement, Measurement) else measurement
        sha256 = await self._transport.digest(source)
        if (await self._call("HEAD", f"/v1/measurements/{sha256}", missing=True)).status_code == 404:
            await self._call("POST", "/v1/measurements", body=source, params=_query(name))
        return sha256

    async def measurement(self, sha256: str) -> Measurement:
        """Return a measurement that the service has."""
        return parse_merl((await self._call("GET", f"/v1/measurements/{sha256}")).content, sha256)

    async def delete_measurement(self, sha256: str) -> None:
        """Delete a measurement; its finished fits stay."""
        await self._call("DELETE", f"/v1/measurements/{sha256}")

    async def wait_until_ready(self, seconds: float = 30.0) -> None:
        """Return when the service can take work, as `Client.wait_until_ready`."""
        last = "it does not answer"
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                answer = await self._transport.request("GET", "/health/ready")
            except httpx.TransportError as error:
                last = str(error)
            else:
                if answer.status_code == 200:
                    return
                last = answer.json().get("detail", answer.reason_phrase)
            await self._transport.sleep(_READY_POLL)
        raise ServiceError({"detail": f"the service at {self._transport.address} is not ready: {last}"})

    async def _result(self, fit_id: str, **query: str) -> Loaded:
        """Return the model of a fit that has succeeded, with its report; or another model that the query names."""
        answer = await self._call("GET", f"/v1/fits/{fit_id}/export", params={"format": "json", **query})
        return from_json(answer.text)

    async def _decomposition(self, fit_id: str, model: DSBRDF) -> Decomposition:
        """Return the components of a fit, whose model is known, as the service has computed them."""
        guide, _ = await self._result(fit_id, component="guide")
        items = (await self._call("GET", f"/v1/fits/{fit_id}/components")).json()["items"]
        return Decomposition(model, guide, tuple(item["label"] for item in items))

    async def _call(
        self,
        method: str,
        url: str,
        *,
        body: bytes | str | PathLike[str] | None = None,
        missing: bool = False,
        **arguments: Any,
    ) -> httpx.Response:
        """Return a response that is a success, or says that something is `missing`; repeat what is refused for now."""
        left = self._patience
        while True:
            if body is not None:
                arguments |= {"content": self._transport.content(body), "headers": _headers_of(body)}
            answer = await self._transport.request(method, url, **arguments)
            if answer.is_success or (missing and answer.status_code == 404):
                return answer
            seconds = _retry_after(answer)
            if answer.status_code not in _REFUSED_FOR_NOW or seconds is None or seconds > left:
                raise _error(answer)
            left -= seconds
            await self._transport.sleep(seconds)

    def _fit(self, document: Mapping[str, Any]) -> _Fit:
        names = ("id", "name", "status", "progress", "measurement", "metrics", "error")
        plain = {name: document[name] for name in names}
        return self._kind(
            **plain, options=from_wire(document["options"]), _load=self._result, _decompose=self._decomposition
        )


def sha256_of(source: bytes | str | PathLike[str]) -> str:
    """Return the sha256 of bytes or of a file."""
    with opened(source) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def opened(source: bytes | str | PathLike[str]) -> BytesIO | BufferedReader:
    """Return bytes or a file as a file that can be read."""
    return BytesIO(source) if isinstance(source, bytes) else Path(source).open("rb")


def parts_of(file: BytesIO | BufferedReader) -> Iterator[bytes]:
    """Yield the bytes of a file in parts."""
    while part := file.read(_CHUNK):
        yield part


def _headers_of(body: bytes | str | PathLike[str]) -> dict[str, str]:
    size = len(body) if isinstance(body, bytes) else Path(body).stat().st_size
    return {"Content-Type": "application/octet-stream", "Content-Length": str(size)}


def _error(answer: httpx.Response) -> Exception:
    """Return the exception for a response that is no success."""
    try:
        problem = answer.json()
    except json.JSONDecodeError:  # to a HEAD, from a proxy, or the server before it knew the request
        status, title = answer.status_code, answer.reason_phrase
        problem = {"status": status, "title": title, "detail": _WITHOUT_BODY.get(status, title)}
    kind = _LIBRARY_ERRORS.get(problem.get("type", ""))
    if kind is not None:
        return kind(problem["detail"])
    if answer.status_code == 401:
        return AccessError(problem)
    if answer.status_code == 429 or problem.get("type") == "urn:dsbrdf:problem:storage-quota":
        return LimitError(problem, _retry_after(answer))
    return ServiceError(problem)


def _retry_after(answer: httpx.Response) -> float | None:
    """Return the time after which the service wants to be asked again, if it names one [s]."""
    seconds = answer.headers.get("retry-after", "")
    return float(seconds) if seconds.isdecimal() else None


def _own_name(measurement: Source) -> str | None:
    """Return the name of a measurement or of its file, if the service would take it."""
    if isinstance(measurement, bytes):
        return None
    name = measurement.name if isinstance(measurement, Measurement) else Path(measurement).stem
    with suppress(InvalidArgumentError):
        return check_name(name)
    return None


def _query(name: str | None) -> dict[str, str]:
    return {} if name is None else {"name": name}
