"""Python clients of the service: the same objects and the same errors as the library, over HTTP.

with Client("http://127.0.0.1:8000") as client:
    fit = client.fit("nickel.binary")
    fit.model.evaluate(theta_half, theta_diff)
    fit.components["diffuse"].albedo

async with AsyncClient("http://127.0.0.1:8000") as client:
    fits = await asyncio.gather(client.fit("nickel.binary"), client.fit("brass.binary"))
    models = [await fit.model() for fit in fits]
"""

import asyncio
import os
import time
from collections.abc import AsyncIterator, Coroutine, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import httpx

from dsbrdf import DSBRDF, Decomposition, FitOptions, FitReport, Measurement
from service.client_requests import (
    POLL,
    AccessError,
    FitState,
    LimitError,
    Loaded,
    Progress,
    Removal,
    Requests,
    ServiceError,
    Source,
    opened,
    parts_of,
    sha256_of,
)

__all__ = ["AccessError", "AsyncClient", "AsyncFit", "Client", "Fit", "LimitError", "ServiceError", "Source"]

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Fit(FitState):
    """The state of a fit when `Client` asked for it, with its model and components."""

    @property
    def model(self) -> DSBRDF:
        """The fitted model, bit for bit as the library fits it."""
        return self._result[0]

    @property
    def report(self) -> FitReport | None:
        """The library's report of the fit."""
        return self._result[1]

    @cached_property
    def components(self) -> Decomposition:
        """The components that `dsbrdf.decompose` finds in the model, computed by the service."""
        return _finish(self._decompose(self.id, self.model))

    @cached_property
    def _result(self) -> Loaded:
        return _finish(self._load(self.id))


@dataclass(frozen=True)
class AsyncFit(FitState):
    """The state of a fit when `AsyncClient` asked for it; what `Fit` has as properties are methods, to be awaited."""

    async def model(self) -> DSBRDF:
        """Return the fitted model, bit for bit as the library fits it."""
        return (await self._load(self.id))[0]

    async def report(self) -> FitReport | None:
        """Return the library's report of the fit."""
        return (await self._load(self.id))[1]

    async def components(self) -> Decomposition:
        """Return the components that `dsbrdf.decompose` finds in the model, computed by the service."""
        return await self._decompose(self.id, await self.model())


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
    patience : float
        Longest time that a request is repeated which the service refuses for now, because of a limit of the key or too
        much work, after the time that it names each time (``Retry-After``) [s]; 0 repeats nothing.
    """

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8000",
        *,
        key: str | None = None,
        timeout: float = 30.0,
        patience: float = 30.0,
    ) -> None:
        self._http = httpx.Client(**_settings(base_url, key, timeout))
        self._requests = Requests(_Blocking(self._http), Fit, patience)

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
        progress: Progress | None = None,
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
        return _finish(self._requests.fit(measurement, options, name=name, progress=progress))

    def submit(self, measurement: Source, options: FitOptions | None = None, *, name: str | None = None) -> Fit:
        """Ask for a fit without waiting for it; parameters and errors as `fit`."""
        return _finish(self._requests.submit(measurement, options, name=name))

    def get(self, fit_id: str, *, wait: float = 0.0) -> Fit:
        """Return a fit, after at most `wait` seconds or when it has ended."""
        return _finish(self._requests.get(fit_id, wait=wait))

    def fits(self, *, name: str | None = None) -> Iterator[Fit]:
        """Yield the service's fits, or those of one name, newest first."""
        fits = self._requests.fits(name=name)  # takes its steps as a coroutine does
        with suppress(StopAsyncIteration):
            while True:
                yield _finish(anext(fits))

    def delete(self, fit_id: str, *, only: Removal | None = None) -> str:
        """Cancel an unfinished fit, or delete one that has ended; return ``"cancelled"`` or ``"deleted"``.

        With `only`, ``"cancel"`` or ``"delete"``, the other one raises ServiceError: a fit may end just before.
        """
        return _finish(self._requests.delete(fit_id, only=only))

    def upload(self, measurement: Source, *, name: str | None = None) -> str:
        """Make sure that the service has a measurement, and return its sha256; errors as `fit`.

        One that is sent gets the `name`, by default its own.
        """
        return _finish(self._requests.upload(measurement, name=name))

    def measurement(self, sha256: str) -> Measurement:
        """Return a measurement that the service has."""
        return _finish(self._requests.measurement(sha256))

    def delete_measurement(self, sha256: str) -> None:
        """Delete a measurement; its finished fits stay."""
        _finish(self._requests.delete_measurement(sha256))

    def wait_until_ready(self, seconds: float = 30.0) -> None:
        """Return when the service can take work.

        Raises
        ------
        ServiceError
            If it cannot after `seconds`.
        """
        _finish(self._requests.wait_until_ready(seconds))


class AsyncClient(Requests[AsyncFit]):
    """Connection to a service for programs with an event loop; parameters, methods and errors as `Client`."""

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8000",
        *,
        key: str | None = None,
        timeout: float = 30.0,
        patience: float = 30.0,
    ) -> None:
        self._http = httpx.AsyncClient(**_settings(base_url, key, timeout))
        super().__init__(_Waiting(self._http), AsyncFit, patience)

    async def __aenter__(self) -> "AsyncClient":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()


class _Blocking:
    """The transport of `Client`: each call has ended when it returns, so there is nothing to wait for."""

    def __init__(self, http: httpx.Client) -> None:
        self._http, self.address = http, http.base_url

    async def request(self, method: str, url: str, **arguments: Any) -> httpx.Response:
        return self._http.request(method, url, **arguments)

    async def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    async def digest(self, source: bytes | str | os.PathLike[str]) -> str:
        return sha256_of(source)

    def content(self, source: bytes | str | os.PathLike[str]) -> Iterator[bytes]:
        with opened(source) as file:
            yield from parts_of(file)


class _Waiting:
    """The transport of `AsyncClient`; files are read in threads."""

    def __init__(self, http: httpx.AsyncClient) -> None:
        self._http, self.address = http, http.base_url

    async def request(self, method: str, url: str, **arguments: Any) -> httpx.Response:
        return await self._http.request(method, url, **arguments)

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def digest(self, source: bytes | str | os.PathLike[str]) -> str:
        return await asyncio.to_thread(sha256_of, source)

    async def content(self, source: bytes | str | os.PathLike[str]) -> AsyncIterator[bytes]:
        with opened(source) as file:
            parts = parts_of(file)
            while part := await asyncio.to_thread(next, parts, b""):
                yield part


def _finish(coroutine: Coroutine[Any, Any, _Result]) -> _Result:
    """Run a coroutine of `Requests` over a `_Blocking` transport, which ends without an event loop."""
    try:
        coroutine.send(None)
    except StopIteration as end:
        result: _Result = end.value
        return result
    raise RuntimeError("a blocking transport has waited for an event loop")


def _settings(base_url: str, key: str | None, timeout: float) -> dict[str, Any]:
    """Return what both of httpx's clients take."""
    key = os.environ.get("DSBRDF_KEY") if key is None else key
    if key and not (key.isascii() and key.isprintable() and " " not in key):
        raise ValueError("the API key has characters that no key has; it is what dsbrdf keys add has printed")
    return {
        "base_url": base_url,
        "headers": {"Authorization": f"Bearer {key}"} if key else {},
        "timeout": httpx.Timeout(timeout, read=timeout + POLL),
        # The service closes a connection that nobody uses for 5 s; none that it may be about to close is used again.
        "limits": httpx.Limits(keepalive_expiry=2.0),
    }
