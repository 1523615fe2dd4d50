"""Use a remote service as an engine, for ``dsbrdf fit --url``."""

from concurrent.futures import Future, ThreadPoolExecutor

import httpx

from dsbrdf import InvalidArgumentError
from dsbrdf.engines.engine import Fault, FitDocument, FitTask, OnProgress, Outcome
from dsbrdf.errors import DSBRDFError

from .client import Client, ServiceError


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
        except (ServiceError, httpx.TransportError) as error:
            if isinstance(error, ServiceError) and error.problem.get("status") == 401:
                advice = "the environment variable DSBRDF_KEY gives the key"
                raise InvalidArgumentError(f"{self._url}: {error}; {advice}") from error
            raise ConnectionError(f"{self._url}: {error}") from error
