"""Fits on a server: the engine behind ``dsbrdf fit --url``."""

import asyncio
from contextlib import AbstractAsyncContextManager

import httpx

from dsbrdf.engines.engine import Fault, FitTask, OnProgress, Outcome
from dsbrdf.errors import DSBRDFError, InvalidArgumentError

from .client import AccessError, Client, ServiceError


class ClientEngine:
    """Asks a service for the fits, with the key in the environment variable ``DSBRDF_KEY`` if there is one.

    Parameters
    ----------
    url : str
        Address of the service.
    count : int
        Most fits that are asked for at once.
    """

    def __init__(self, url: str, count: int) -> None:
        self._url, self._count, self._closed = url, count, False

    async def start(self) -> None:
        """Connect to the service."""
        self._slots = asyncio.Semaphore(self._count)
        self._client = Client(self._url)

    def slot(self) -> AbstractAsyncContextManager[object]:
        """Wait until one more fit may be asked for."""
        return self._slots

    async def run(self, task: FitTask, on_progress: OnProgress) -> Outcome:
        """Ask for a fit and wait for it.

        Raises
        ------
        ConnectionError
            If the service cannot be reached, or fails for another reason than the measurement or the options.
        InvalidArgumentError
            If the service wants a key.
        """
        return await asyncio.to_thread(self._fit, task, on_progress)

    async def check(self) -> None:
        """Do nothing: the first fit says whether the service answers."""

    async def close(self) -> None:
        """End the waiting for fits and the connections."""
        self._closed = True
        self._client.close()

    def _fit(self, task: FitTask, on_progress: OnProgress) -> Outcome:
        def report(share: float) -> None:
            if self._closed:
                raise InterruptedError("the command was interrupted")
            on_progress(share)

        try:
            return self._client.fit(task.path, task.options, progress=report)
        except DSBRDFError as error:
            return Fault("input", type(error).__name__, str(error))
        except AccessError as error:
            raise InvalidArgumentError(
                f"{self._url}: {error}; the environment variable DSBRDF_KEY gives the key"
            ) from error
        except (ServiceError, httpx.TransportError) as error:
            raise ConnectionError(f"{self._url}: {error}") from error
