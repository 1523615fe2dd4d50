"""Use the service from Python, with the objects and errors of the library; `dsbrdf fit --url` uses it as an engine.

with Client("http://127.0.0.1:8000") as client:
    result = client.fit("nickel.binary")  # Like dsbrdf.fit.
    result.model.evaluate(theta_half, theta_diff)
"""

import hashlib
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from dsbrdf import FitError, FitOptions, FitResult, InvalidArgumentError, Measurement, MeasurementFormatError
from dsbrdf.data.merl import encode_merl
from dsbrdf.data.rgl import read_rgl
from dsbrdf.engines.engine import Fault, FitDocument, FitTask, OnProgress, Outcome
from dsbrdf.errors import DSBRDFError
from dsbrdf.output.serialize import result_from_json
from dsbrdf.samples.reading import kind_of_file, samples_in
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.samples.table_options import AS_WRITTEN, TableOptions

from .wire import check_name, to_wire

Source = str | os.PathLike[str] | bytes | Measurement | ScatteredSamples
Document = dict[str, Any]
"""JSON document of a fit, as ``GET /v1/fits/{id}`` returns it."""

_LONG_POLL_S = 20.0  # One request waits for a fit at most for this time.
_PROGRESS_INTERVAL_S = 0.5  # With a progress callback, one request waits at most for this time.
_LIBRARY_ERRORS: dict[str, type[Exception]] = {
    "urn:dsbrdf:problem:measurement-format": MeasurementFormatError,
    "urn:dsbrdf:problem:measurement-too-large": MeasurementFormatError,
    "urn:dsbrdf:problem:invalid-argument": InvalidArgumentError,
    "urn:dsbrdf:problem:fit-impossible": FitError,
}


class ServiceError(Exception):
    """The service could not fulfil a request, for a reason other than the measurement or the options.

    `problem` is the problem document, or has at least ``status`` and ``title``. The status is 401 if the key is
    missing or wrong, and 429 if the key has reached a limit.
    """

    def __init__(self, problem: Mapping[str, Any]) -> None:
        super().__init__(problem.get("detail") or problem["title"])
        self.problem = dict(problem)


class Client:
    """Connect to a service.

    Parameters
    ----------
    base_url : str
        Address of the service.
    key : str, optional
        API key; by default the value of the environment variable ``DSBRDF_KEY``, if it is set.
    timeout : float
        Maximum time without an answer, besides the wait for a fit [s]. During this time, a request that the service
        refuses temporarily is sent again after the pause in ``Retry-After``.
    """

    def __init__(
        self, base_url: str = "http://127.0.0.1:8000", *, key: str | None = None, timeout: float = 30.0
    ) -> None:
        key = os.environ.get("DSBRDF_KEY") if key is None else key
        if key and not (key.isascii() and key.isprintable() and " " not in key):
            raise ValueError(
                "the API key contains characters that no key has; copy the key that dsbrdf keys add printed"
            )
        self._timeout = timeout
        self._http = httpx.Client(
            base_url=base_url,
            headers={"Authorization": f"Bearer {key}"} if key else {},
            timeout=httpx.Timeout(timeout, read=timeout + _LONG_POLL_S),
            # The service closes idle connections after 5 s; a connection that may be closing is not used again.
            limits=httpx.Limits(keepalive_expiry=2.0),
        )

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
        table: TableOptions = AS_WRITTEN,
        name: str | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> FitResult:
        """Fit a measurement; return the same result as `dsbrdf.fit`, bit for bit.

        Parameters
        ----------
        measurement : path-like, bytes, Measurement or ScatteredSamples
            A file as for `dsbrdf.fit`, the bytes of a MERL file, or a measurement. The measurement is sent only if the
            service does not have it.
        options : FitOptions, optional
            Options of the fit; ``FitOptions()`` by default.
        table : TableOptions, optional
            Options for reading a table.
        name : str, optional
            Name of the measurement and the fit in the service; by default the present name, or that of the file.
        progress : callable, optional
            Called with the progress, 0 to 1, about twice a second.

        Raises
        ------
        MeasurementFormatError, InvalidArgumentError, FitError
            In the same cases as `dsbrdf.fit`, with the same sentence.
        ServiceError
            If the service failed, or the fit was cancelled.
        ConnectionError
            If no service answers at the address, or the connection is lost.
        """
        submitted = self.submit(measurement, options, table=table, name=name)
        return self.result(self.wait(submitted, progress)["id"])

    def submit(
        self,
        measurement: Source,
        options: FitOptions | None = None,
        *,
        table: TableOptions = AS_WRITTEN,
        name: str | None = None,
    ) -> Document:
        """Request a fit without waiting for it; return the fit's document. Parameters and errors are as for `fit`."""
        sha256, headers = self.upload(measurement, table, name=name), {"Prefer": "respond-async"}
        document = {"measurement": sha256, "options": to_wire(options or FitOptions())}
        found: Document = self._call("POST", "/v1/fits", {"name": name}, json=document, headers=headers).json()
        return found

    def get(self, fit_id: str, *, wait: float = 0.0) -> Document:
        """Return the document of a fit, when the fit has ended or after at most `wait` seconds."""
        found: Document = self._call("GET", f"/v1/fits/{fit_id}", {"wait": wait}).json()
        return found

    def wait(self, fit: Document, progress: Callable[[float], None] | None = None) -> Document:
        """Wait until a fit has ended, and return its document; parameters and errors are as for `fit`."""
        while fit["status"] in ("accepted", "running"):
            if progress is not None:
                progress(fit["progress"])
            fit = self.get(fit["id"], wait=_LONG_POLL_S if progress is None else _PROGRESS_INTERVAL_S)
        if fit["status"] != "succeeded":
            error = fit["error"] or {"origin": "system", "message": "The fit was cancelled."}
            if error["origin"] == "input":
                raise FitError(error["message"])
            raise ServiceError({**error, "detail": error["message"]})
        if progress is not None:
            progress(1.0)
        return fit

    def result(self, fit_id: str) -> FitResult:
        """Return the model and the report of a fit that has succeeded."""
        return result_from_json(self.document(fit_id))

    def document(self, fit_id: str) -> str:
        """Return the result of a fit as the text of a file that `dsbrdf.load` reads."""
        return self._call("GET", f"/v1/fits/{fit_id}/export", {"format": "json"}).text

    def upload(self, measurement: Source, options: TableOptions = AS_WRITTEN, *, name: str | None = None) -> str:
        """Make sure that the service has a measurement, and return its sha256; parameters and errors are as for `fit`.

        The client reads a table with `options`, and sends the samples in the service's own format.
        """
        headers, own_name = {"Content-Type": "application/octet-stream"}, None
        if isinstance(measurement, str | os.PathLike):
            path = Path(measurement)
            own_name, samples = path.stem, samples_in(path, options)
            if samples is not None:
                measurement = samples
            else:
                measurement = read_rgl(path).measurement() if kind_of_file(path) == "rgl" else path.read_bytes()
        if isinstance(measurement, ScatteredSamples):
            headers = {"Content-Type": "text/csv"}
            own_name, measurement = measurement.name, measurement.encode()
        if isinstance(measurement, Measurement):
            own_name, measurement = measurement.name, encode_merl(measurement)
        sha256 = hashlib.sha256(measurement).hexdigest()
        try:
            self._call("GET", f"/v1/measurements/{sha256}/content", headers={"If-None-Match": f'"{sha256}"'})
        except ServiceError as error:
            if error.problem["status"] != 404:
                raise
            if own_name is not None:
                with suppress(InvalidArgumentError):  # A file name that the service refuses is not sent.
                    name = name or check_name(own_name)
            self._call("POST", "/v1/measurements", {"name": name}, content=measurement, headers=headers)
        return sha256

    def _call(self, method: str, url: str, params: Mapping[str, Any] | None = None, **request: Any) -> httpx.Response:
        """Send a request, repeat it while the service refuses it temporarily, and return the successful response.

        Parameters that are None are left out.
        """
        given = {name: value for name, value in (params or {}).items() if value is not None}
        left = self._timeout
        try:
            while (answer := self._http.request(method, url, params=given, **request)).status_code in (429, 503):
                given_pause = answer.headers.get("retry-after", "")
                if not given_pause.isdecimal():
                    break
                pause = max(1, int(given_pause))  # A pause of 0 s, which proxies may name, would never end the loop.
                if pause > left:
                    break
                left -= pause
                time.sleep(pause)
        except httpx.TransportError as error:
            address = str(self._http.base_url).rstrip("/")
            if isinstance(error, httpx.ConnectError | httpx.ConnectTimeout):
                advice = "is a service running there? dsbrdf serve starts one"
                raise ConnectionError(f"nothing answers at {address}: {advice} ({error})") from error
            raise ConnectionError(f"the request to {address} failed: {str(error) or type(error).__name__}") from error
        if answer.status_code < 400:
            return answer
        title = f"{answer.status_code} {answer.reason_phrase}"
        problem: dict[str, Any] = {"status": answer.status_code, "title": title}
        with suppress(ValueError):  # A proxy may answer without JSON, or in another encoding than UTF-8.
            document = answer.json()
            if isinstance(document, dict):
                problem |= document
        kind = _LIBRARY_ERRORS.get(problem.get("type", ""))
        raise ServiceError(problem) if kind is None else kind(problem["detail"])


class ClientEngine:
    """Request at most `count` fits at once from the service at `url`.

    The environment variable ``DSBRDF_KEY`` contains the API key, if the service needs a key.
    """

    def __init__(self, url: str, count: int) -> None:
        self._url, self._client = url, Client(url)
        self._threads = ThreadPoolExecutor(count)

    def submit(self, task: FitTask, on_progress: OnProgress) -> "Future[Outcome]":
        """Request a fit.

        The future raises ConnectionError if the service cannot be reached, or fails for another reason than the
        measurement or the options. The future raises InvalidArgumentError if the service needs another API key.
        """
        return self._threads.submit(self._fit, task, on_progress)

    def check(self) -> None:
        """Do nothing, because the first fit shows whether the service answers."""

    def close(self) -> None:
        """Stop waiting for the requested fits, and close the connections."""
        self._client.close()
        self._threads.shutdown(cancel_futures=True)

    def _fit(self, task: FitTask, on_progress: OnProgress) -> Outcome:
        try:
            measurement = task.path if task.samples is None else task.samples
            fit = self._client.wait(self._client.submit(measurement, task.options), on_progress)
            return FitDocument(self._client.document(fit["id"]), fit["metrics"])
        except DSBRDFError as error:
            return Fault("input", type(error).__name__, str(error))
        except ServiceError as error:
            if error.problem.get("status") == 401:
                advice = "the environment variable DSBRDF_KEY gives the key"
                raise InvalidArgumentError(f"{self._url}: {error}; {advice}") from error
            raise ConnectionError(f"{self._url}: {error}") from error
