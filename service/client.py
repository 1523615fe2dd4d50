"""Python client of the service: the same objects and the same errors as the library, over HTTP.

with Client("http://127.0.0.1:8000") as client:
    fit = client.fit("nickel.binary")
    fit.model.evaluate(theta_half, theta_diff)
    dsbrdf.decompose(fit.model).diffuse
"""

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Any

import httpx

from dsbrdf import DSBRDF, FitError, FitOptions, FitReport, InvalidArgumentError, Measurement, MeasurementFormatError
from dsbrdf.data.merl import encode_merl, parse_merl
from dsbrdf.output.serialize import from_json
from service.wire.fit_options import from_wire, to_wire
from service.wire.names import check_name

Source = str | os.PathLike[str] | bytes | Measurement

_RAW = "application/octet-stream"
_POLL = 20.0  # seconds that one request waits for a fit
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
class Fit:
    """The state of a fit of the service when it was asked for."""

    id: str
    status: str
    progress: float  # finished share, 0 to 1
    measurement: str  # its sha256
    name: str | None
    options: FitOptions
    metrics: dict[str, float | None] | None  # as in the library's report, once the fit has succeeded
    error: dict[str, str] | None  # origin, type and message if it has failed
    _export: Callable[[str], str] = field(repr=False, compare=False)

    @property
    def ended(self) -> bool:
        """Whether the fit is over, well or not."""
        return self.status not in ("accepted", "running")

    @property
    def model(self) -> DSBRDF:
        """The fitted model, bit for bit as the library fits it."""
        return self._result[0]

    @property
    def report(self) -> FitReport | None:
        """The library's report of the fit."""
        return self._result[1]

    @cached_property
    def _result(self) -> tuple[DSBRDF, FitReport | None]:
        return from_json(self._export(self.id))


class Client:
    """Connection to a service.

    Parameters
    ----------
    base_url : str
        Address of the service.
    key : str, optional
        API key; by default that of the environment variable ``DSBRDF_KEY``, if there is one.
    timeout : float
        Longest time without an answer, other than while waiting for a fit [s].
    """

    def __init__(
        self, base_url: str = "http://127.0.0.1:8000", *, key: str | None = None, timeout: float = 30.0
    ) -> None:
        key = os.environ.get("DSBRDF_KEY") if key is None else key
        if key and not (key.isascii() and key.isprintable() and " " not in key):
            raise ValueError("the API key has characters that no key has; it is what dsbrdf keys add has printed")
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        patience = httpx.Timeout(timeout, read=timeout + _POLL)
        # The service closes a connection that nobody uses for 5 s; none that it may be about to close is used again.
        kept = httpx.Limits(keepalive_expiry=2.0)
        self._http = httpx.Client(base_url=base_url, headers=headers, timeout=patience, limits=kept)

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def fit(
        self,
        measurement: Source,
        options: FitOptions | None = None,
        *,
        name: str | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Fit:
        """Fit a measurement and return when the fit has succeeded.

        Parameters
        ----------
        measurement : path-like, bytes or Measurement
            A MERL file, its bytes, or a measurement. It is sent only if the service does not have it.
        options : FitOptions, optional
            Defaults to ``FitOptions()``.
        name : str, optional
            What the service calls the measurement and the fit; by default the name that they have, or the file's.
        progress : callable, optional
            Called with the finished share, 0 to 1, about twice a second.

        Raises
        ------
        MeasurementFormatError, InvalidArgumentError, FitError
            As the library does, with the same sentence.
        ServiceError
            If the service failed, or the fit was cancelled.
        """
        fit = self.submit(measurement, options, name=name)
        while not fit.ended:
            if progress is not None:
                progress(fit.progress)
            fit = self.get(fit.id, wait=_POLL if progress is None else 0.5)
        if fit.status == "succeeded":
            if progress is not None:
                progress(1.0)
            return fit
        error = fit.error or {"origin": "system", "type": "Cancelled", "message": "The fit was cancelled."}
        if error["origin"] == "input":
            raise FitError(error["message"])
        raise ServiceError({**error, "title": error["type"], "detail": error["message"]})

    def submit(self, measurement: Source, options: FitOptions | None = None, *, name: str | None = None) -> Fit:
        """Ask for a fit without waiting for it; parameters and errors as `fit`."""
        document = {"measurement": self.upload(measurement, name=name), "options": to_wire(options or FitOptions())}
        asynchronous = {"Prefer": "respond-async"}
        answer = self._call("POST", "/v1/fits", json=document, headers=asynchronous, params=_query(name))
        return self._fit(answer.json())

    def get(self, fit_id: str, *, wait: float = 0.0) -> Fit:
        """Return a fit, after at most `wait` seconds or when it has ended."""
        return self._fit(self._call("GET", f"/v1/fits/{fit_id}", params={"wait": wait}).json())

    def fits(self, *, name: str | None = None) -> Iterator[Fit]:
        """Yield the service's fits, or those of one name, newest first."""
        url: str | None = str(httpx.URL("/v1/fits", params=_query(name)))
        while url is not None:
            answer = self._call("GET", url)
            for document in answer.json()["items"]:
                yield self._fit(document)
            url = answer.links.get("next", {}).get("url")

    def delete(self, fit_id: str) -> None:
        """Cancel an unfinished fit, or delete one that has ended."""
        self._call("DELETE", f"/v1/fits/{fit_id}")

    def upload(self, measurement: Source, *, name: str | None = None) -> str:
        """Make sure that the service has a measurement, and return its sha256; errors as `fit`.

        One that is sent gets the `name`, by default its own.
        """
        own_name = _own_name(measurement)
        if isinstance(measurement, Measurement):
            measurement = encode_merl(measurement)
        with _opened(measurement) as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        probe = self._http.head(f"/v1/measurements/{sha256}")
        if probe.is_success:
            return sha256
        if probe.status_code != 404:
            raise _error(probe)
        with _opened(measurement) as file:
            raw = {"Content-Type": _RAW}
            self._call("POST", "/v1/measurements", content=file, headers=raw, params=_query(name or own_name))
        return sha256

    def measurement(self, sha256: str) -> Measurement:
        """Return a measurement that the service has."""
        return parse_merl(self._call("GET", f"/v1/measurements/{sha256}").content, sha256)

    def delete_measurement(self, sha256: str) -> None:
        """Delete a measurement; its finished fits stay."""
        self._call("DELETE", f"/v1/measurements/{sha256}")

    def wait_until_ready(self, seconds: float = 30.0) -> None:
        """Return when the service can take work.

        Raises
        ------
        ServiceError
            If it cannot after `seconds`.
        """
        last = "it does not answer"
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                answer = self._http.get("/health/ready")
            except httpx.TransportError as error:
                last = str(error)
            else:
                if answer.status_code == 200:
                    return
                last = answer.json().get("detail", answer.reason_phrase)
            time.sleep(0.1)
        raise ServiceError({"detail": f"the service at {self._http.base_url} is not ready: {last}"})

    def _call(self, method: str, url: str, **arguments: Any) -> httpx.Response:
        answer = self._http.request(method, url, **arguments)
        if answer.is_success:
            return answer
        raise _error(answer)

    def _fit(self, document: Mapping[str, Any]) -> Fit:
        names = ("id", "name", "status", "progress", "measurement", "metrics", "error")
        plain = {name: document[name] for name in names}
        return Fit(**plain, options=from_wire(document["options"]), _export=self._export)

    def _export(self, fit_id: str) -> str:
        return self._call("GET", f"/v1/fits/{fit_id}/export", params={"format": "json"}).text


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
        seconds = answer.headers.get("retry-after", "")
        return LimitError(problem, float(seconds) if seconds.isdecimal() else None)
    return ServiceError(problem)


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


def _opened(measurement: str | os.PathLike[str] | bytes) -> BytesIO | BufferedReader:
    return BytesIO(measurement) if isinstance(measurement, bytes) else Path(measurement).open("rb")
