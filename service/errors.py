"""Every error that the service raises on purpose, as one tree.

DSBRDFServiceError
├── DataFolderError                  the data folder cannot be opened
│   └── DataFolderInUseError         another server has it open
├── DatabaseBusyError                other transactions take too long (also a sqlite3.OperationalError)
├── DatabaseLostError                the database's file has been removed or replaced (also an OSError)
├── CheckFailedError                 a check of `dsbrdf doctor` has found a fault
└── ProblemError                     answered with a problem document of its kind:
    ├── BadRequestError              bad-request
    ├── BadEncodingError             bad-encoding
    ├── UnauthorizedError            unauthorized
    ├── StorageQuotaError            storage-quota
    ├── NotFoundError                not-found
    │   ├── FitNotFoundError
    │   └── MeasurementNotFoundError
    ├── NotAcceptableError           not-acceptable
    ├── RequestTimeoutError          request-timeout
    ├── MeasurementInUseError        measurement-in-use
    ├── FitNotFinishedError          fit-not-finished
    ├── FitWithoutResultError        fit-without-result
    ├── TooLargeError                too-large
    ├── MeasurementTooLargeError     measurement-too-large
    ├── UnsupportedMediaTypeError    unsupported-media-type
    ├── RangeNotSatisfiableError     range-not-satisfiable
    ├── RateLimitedError             rate-limited
    ├── QueueQuotaError              queue-quota
    ├── QueueFullError               queue-full
    ├── OverloadedError              overloaded
    ├── ShuttingDownError            shutting-down
    └── NotReadyError                not-ready

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

    Parameters
    ----------
    detail : str
        One sentence: what is wrong and what would be right.
    headers : mapping, optional
        Further headers of the response, beside those of the class.

    Attributes
    ----------
    kind : str
        Key of the table `service.http.problems.KINDS`.
    detail : str
    headers : dict
        Headers of the response.
    """

    kind: ClassVar[str]
    default_headers: ClassVar[tuple[tuple[str, str], ...]] = ()

    def __init__(self, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.detail = detail
        self.headers = {**dict(self.default_headers), **(headers or {})}


class BadRequestError(ProblemError):
    """The request cannot be understood."""

    kind = "bad-request"


class BadEncodingError(ProblemError):
    """The body does not decode."""

    kind = "bad-encoding"


class UnauthorizedError(ProblemError):
    """A valid API key is needed."""

    kind = "unauthorized"
    default_headers = (("WWW-Authenticate", "Bearer"),)


class StorageQuotaError(ProblemError):
    """The caller has stored as much as it may, or would with this measurement."""

    kind = "storage-quota"


class NotFoundError(ProblemError):
    """There is no such resource."""

    kind = "not-found"


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


class NotAcceptableError(ProblemError):
    """The resource has no representation that the client accepts."""

    kind = "not-acceptable"


class RequestTimeoutError(ProblemError):
    """The request did not arrive in time."""

    kind = "request-timeout"
    default_headers = (("Connection", "close"),)


class MeasurementInUseError(ProblemError):
    """Unfinished fits use the measurement."""

    kind = "measurement-in-use"


class FitNotFinishedError(ProblemError):
    """The fit has not finished, so it has no model yet."""

    kind = "fit-not-finished"
    default_headers = (("Retry-After", "1"),)


class FitWithoutResultError(ProblemError):
    """The fit has ended without a model."""

    kind = "fit-without-result"


class TooLargeError(ProblemError):
    """The body, or what it asks for, is too large."""

    kind = "too-large"


class MeasurementTooLargeError(ProblemError):
    """The file is longer than a MERL measurement."""

    kind = "measurement-too-large"


class UnsupportedMediaTypeError(ProblemError):
    """The body's type or encoding is not supported."""

    kind = "unsupported-media-type"


class RangeNotSatisfiableError(ProblemError):
    """The file does not have the range of bytes that was asked for."""

    kind = "range-not-satisfiable"


class RateLimitedError(ProblemError):
    """The key makes more requests per second than it may."""

    kind = "rate-limited"


class QueueQuotaError(ProblemError):
    """The caller has as many unfinished fits as it may have."""

    kind = "queue-quota"
    default_headers = (("Retry-After", "5"),)


class QueueFullError(ProblemError):
    """As many fits are waiting as may wait."""

    kind = "queue-full"
    default_headers = (("Retry-After", "10"),)


class OverloadedError(ProblemError):
    """As many requests are in progress as may be."""

    kind = "overloaded"
    default_headers = (("Retry-After", "1"),)


class ShuttingDownError(ProblemError):
    """The service ends before the request can be answered."""

    kind = "shutting-down"
    default_headers = (("Retry-After", "10"),)


class NotReadyError(ProblemError):
    """The service cannot take work at present."""

    kind = "not-ready"
    default_headers = (("Retry-After", "10"),)


def validation_sentence(errors: Sequence[Mapping[str, Any]]) -> str:
    """Return pydantic's list of errors as one sentence."""
    parts = []
    for error in errors[:3]:
        place = ".".join(str(part) for part in error["loc"] if part not in ("body", "query", "path"))
        message = str(error["msg"])
        parts.append(f"{place}: {message[:1].lower()}{message[1:]}" if place else message)
    more = f"; and {len(errors) - 3} more" if len(errors) > 3 else ""
    return "; ".join(parts) + more + "."
