"""Convert exceptions to RFC 9457 problem documents, by one table of all kinds of problems.

The ``type`` of a problem is stable, so that scripts may depend on it. The ``detail`` of a problem is
one sentence for a person.
"""

import errno
import logging
import sqlite3
from typing import Annotated, NamedTuple

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response
from starlette.routing import Match

from dsbrdf.errors import FitError, InvalidArgumentError, MeasurementFormatError
from dsbrdf.extras import MissingExtraError

from ..errors import ProblemError, validation_sentence

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:dsbrdf:problem:"


class Problem(BaseModel):
    """A problem document of RFC 9457, the answer to a failed request."""

    type: Annotated[str, Field(description="Stable name of the problem, for scripts.")]
    title: str
    status: int
    detail: Annotated[str, Field(description="One sentence: the mistake and the remedy.")]
    instance: str


class Kind(NamedTuple):
    """Describe a kind of problem: its status, its title, and the time after which a retry may succeed [s]."""

    status: int
    title: str
    retry_after: int | None = None


_FULL = "The disk of the service is too full for this request; delete measurements, or try again later."
_BROKEN = "The service failed at this request; its log says why."
_UNUSABLE = "The service cannot use its data folder now; its log says why. Try again when /health/ready answers 200."
KINDS: dict[str, Kind] = {
    "bad-request": Kind(400, "The request cannot be understood"),
    "unauthorized": Kind(401, "A valid API key is needed"),
    "foreign-origin": Kind(403, "The request comes from another site"),
    "storage-quota": Kind(403, "The key's storage is full"),
    "not-found": Kind(404, "There is no such resource"),
    "measurement-damaged": Kind(404, "The measurement has to be uploaded again"),
    "method-not-allowed": Kind(405, "The resource does not support this method"),
    "request-timeout": Kind(408, "The request did not arrive in time"),
    "measurement-in-use": Kind(409, "Unfinished fits use the measurement"),
    "fit-not-finished": Kind(409, "The fit has not finished", 1),
    "fit-without-result": Kind(409, "The fit has no result"),
    "fit-ended": Kind(409, "The fit has ended"),
    "too-large": Kind(413, "The body is too large"),
    "measurement-too-large": Kind(413, "The file is too long"),
    "unsupported-media-type": Kind(415, "The body's type or encoding is not supported"),
    "head-too-long": Kind(431, "The request line or the headers are too long"),
    "misdirected": Kind(421, "The service does not have this host name"),
    "measurement-format": Kind(422, "Not an acceptable measurement"),
    "invalid-argument": Kind(422, "An argument is not acceptable"),
    "too-costly": Kind(422, "The computation takes too much time or memory"),
    "fit-impossible": Kind(422, "The measurement cannot be fitted with these options"),
    "rate-limited": Kind(429, "Too many requests"),
    "too-many-at-once": Kind(429, "Too many requests of the caller at once", 5),
    "queue-quota": Kind(429, "Too many fits of the key are waiting", 5),
    "internal": Kind(500, "The service failed"),
    "not-installed": Kind(501, "The service lacks a library"),
    "queue-full": Kind(503, "Too many fits are waiting", 10),
    "overloaded": Kind(503, "Too many requests are in progress", 1),
    "interrupted": Kind(503, "The computation was interrupted", 1),
    "shutting-down": Kind(503, "The service is shutting down", 10),
    "not-ready": Kind(503, "The service is not ready", 10),
    "disk-full": Kind(507, "The service's disk is full", 30),
}

# Each error of the library becomes a problem of this kind.
_KIND_OF_ERROR: dict[type[Exception], str] = {
    MeasurementFormatError: "measurement-format",
    InvalidArgumentError: "invalid-argument",
    FitError: "fit-impossible",
    MissingExtraError: "not-installed",
}
_IDS = {
    ("path", "fit_id"): "id of a fit, which has 32 hexadecimal digits; GET /v1/fits lists your fits",
    ("path", "sha256"): "id of a measurement, which has 64 hexadecimal digits; GET /v1/measurements lists yours",
}
_FULL_DISK = (errno.ENOSPC, errno.EDQUOT)

logger = logging.getLogger(__name__)


def problem_response(error: ProblemError, path: str) -> Response:
    """Return the problem document of `error` as a response."""
    status, title, retry_after = KINDS[error.kind]
    headers = {} if retry_after is None else {"Retry-After": str(retry_after)}
    # A lone surrogate, which JSON can escape but UTF-8 cannot encode, is shown as its escape sequence.
    detail = error.detail.encode(errors="backslashreplace").decode()
    about = {"title": title, "status": status, "detail": detail, "instance": path}
    return JSONResponse({"type": TYPE_PREFIX + error.kind, **about}, status, headers | error.headers, MEDIA_TYPE)


def problem_of(request: Request, error: Exception) -> ProblemError:
    """Return an exception as a problem; log it if the service itself is at fault."""
    path = request.url.path
    if isinstance(error, ProblemError):
        return error
    if isinstance(error, ClientDisconnect):  # Nobody receives this answer, but the log and the metrics record it.
        return ProblemError("bad-request", "The client disconnected before the end of the body.")
    if isinstance(error, RequestValidationError):
        for fault in error.errors():  # An ill-formed id is answered as not found.
            if fault["loc"] in _IDS:
                return ProblemError("not-found", f"{str(fault['input'])[:64]!r} is no {_IDS[fault['loc']]}.")
            if fault["loc"][0] == "path":
                return _nothing_at(path)
        return ProblemError("invalid-argument", validation_sentence(error.errors()))
    if isinstance(error, HTTPException) and error.status_code == 404:
        return _nothing_at(path)
    if isinstance(error, HTTPException) and error.status_code == 405:
        allowed = ", ".join(_methods(request))
        detail = f"{request.method} is not supported at {path}; supported: {allowed}."
        return ProblemError("method-not-allowed", detail, {"Allow": allowed})
    for expected, kind in _KIND_OF_ERROR.items():
        if isinstance(error, expected):
            return ProblemError(kind, str(error))
    if isinstance(error, (OSError, sqlite3.DatabaseError)):
        if getattr(error, "errno", 0) in _FULL_DISK or getattr(error, "sqlite_errorcode", 0) == sqlite3.SQLITE_FULL:
            return ProblemError("disk-full", _FULL)
        logger.error("%s %s: the data folder cannot be used (%s)", request.method, path, error)
        return ProblemError("not-ready", _UNUSABLE)
    logger.error("%s %s failed", request.method, path, exc_info=error)
    return ProblemError("internal", _BROKEN)


def _nothing_at(path: str) -> ProblemError:
    return ProblemError("not-found", f"The service has nothing at {path}; GET /docs lists all paths.")


def _methods(request: Request) -> list[str]:
    """Return the methods that the path of a request supports; HEAD is supported where GET is."""
    there = [route for route in request.app.routes if route.matches(request.scope)[0] is not Match.NONE]
    found = {method for route in there for method in route.methods}
    return sorted(found | {"HEAD"} if "GET" in found else found)
