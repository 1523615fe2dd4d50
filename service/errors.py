"""Every error that the service raises on purpose, as one tree.

DSBRDFServiceError
├── DataFolderError                  the data folder cannot be opened
│   └── DataFolderInUseError         another server has it open
├── DatabaseBusyError                other transactions take too long (also a sqlite3.OperationalError)
├── DatabaseLostError                the database's file has been removed or replaced (also an OSError)
├── CheckFailedError                 a check of `dsbrdf doctor` has found a fault
└── ProblemError                     answered with a problem document; a class for each kind
    └── NotFoundError
        ├── FitNotFoundError
        └── MeasurementNotFoundError

The library's own errors and those of the machine are answered with problem documents too: `service.http.problems`.
"""

import sqlite3
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar


class DSBRDFServiceError(Exception):
    """Base of every error that the service raises on purpose."""


class DataFolderError(DSBRDFServiceError):
    """The data folder cannot be opened; the message says why."""


class DataFolderInUseError(DataFolderError):
    """Another server has the data folder open."""


class DatabaseBusyError(DSBRDFServiceError, sqlite3.OperationalError):
    """Other transactions have not let this one begin in time."""

    sqlite_errorcode = sqlite3.SQLITE_BUSY


class DatabaseLostError(DSBRDFServiceError, OSError):
    """The database's file has been removed or replaced: what is written now would be lost with this process."""


class CheckFailedError(DSBRDFServiceError):
    """A check of `dsbrdf doctor` has found a fault; the message says which, and what would help."""


class ProblemError(DSBRDFServiceError):
    """The request cannot be fulfilled; the client gets a problem document.

    `detail` is one sentence: what is wrong and what would be right. `kind` is a key of `service.http.problems.KINDS`;
    after `retry_after` seconds it is worth asking again, unless `headers` say otherwise.
    """

    kind: ClassVar[str]
    retry_after: ClassVar[int | None]

    def __init_subclass__(cls, kind: str = "", retry_after: int | None = None) -> None:
        if kind:  # a subclass of a kind has the same one
            cls.kind, cls.retry_after = kind, retry_after

    def __init__(self, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.detail = detail
        self.headers = dict(headers or {})
        if self.retry_after is not None:
            self.headers.setdefault("Retry-After", str(self.retry_after))


class BadRequestError(ProblemError, kind="bad-request"):
    """The request cannot be understood."""


class BadEncodingError(ProblemError, kind="bad-encoding"):
    """The body does not decode."""


class UnauthorizedError(ProblemError, kind="unauthorized"):
    """A valid API key is needed."""


class StorageQuotaError(ProblemError, kind="storage-quota"):
    """The caller has stored as much as it may, or would with this measurement."""


class NotFoundError(ProblemError, kind="not-found"):
    """There is no such resource."""


class FitNotFoundError(NotFoundError):
    """The caller has no fit with this id."""

    def __init__(self, fit_id: str) -> None:
        super().__init__(f"There is no fit {fit_id[:64]!r}; GET /v1/fits lists those that there are.")


class MeasurementNotFoundError(NotFoundError):
    """The caller has no measurement with this sha256."""

    def __init__(self, sha256: str) -> None:
        super().__init__(
            f"There is no measurement {sha256[:64]!r}; upload it with POST /v1/measurements or POST /v1/fits."
        )


class NotAcceptableError(ProblemError, kind="not-acceptable"):
    """The resource has no representation that the client accepts."""


class RequestTimeoutError(ProblemError, kind="request-timeout"):
    """The request did not arrive in time."""


class MeasurementInUseError(ProblemError, kind="measurement-in-use"):
    """Unfinished fits use the measurement."""


class FitNotFinishedError(ProblemError, kind="fit-not-finished", retry_after=1):
    """The fit has not finished, so it has no model yet."""


class FitWithoutResultError(ProblemError, kind="fit-without-result"):
    """The fit has ended without a model."""


class TooLargeError(ProblemError, kind="too-large"):
    """The body, or what it asks for, is too large."""


class MeasurementTooLargeError(ProblemError, kind="measurement-too-large"):
    """The file is longer than a MERL measurement."""


class UnsupportedMediaTypeError(ProblemError, kind="unsupported-media-type"):
    """The body's type or encoding is not supported."""


class RangeNotSatisfiableError(ProblemError, kind="range-not-satisfiable"):
    """The file does not have the range of bytes that was asked for."""


class RateLimitedError(ProblemError, kind="rate-limited"):
    """The key makes more requests per second than it may."""


class QueueQuotaError(ProblemError, kind="queue-quota", retry_after=5):
    """The caller has as many unfinished fits as it may have."""


class QueueFullError(ProblemError, kind="queue-full", retry_after=10):
    """As many fits are waiting as may wait."""


class OverloadedError(ProblemError, kind="overloaded", retry_after=1):
    """As many requests are in progress as may be."""


class ShuttingDownError(ProblemError, kind="shutting-down", retry_after=10):
    """The service ends before the request can be answered."""


class NotReadyError(ProblemError, kind="not-ready", retry_after=10):
    """The service cannot take work at present."""


def validation_sentence(errors: Sequence[Mapping[str, Any]]) -> str:
    """Return pydantic's list of errors as one sentence."""
    parts = []
    for error in errors[:3]:
        place = ".".join(str(part) for part in error["loc"] if part not in ("body", "query", "path"))
        message = str(error["msg"])
        parts.append(f"{place}: {message[:1].lower()}{message[1:]}" if place else message)
    more = f"; and {len(errors) - 3} more" if len(errors) > 3 else ""
    return "; ".join(parts) + more + "."
