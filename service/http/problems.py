"""From exception to RFC 9457 problem document: one table, used for every status that is an error.

A problem's ``type`` is stable: scripts may branch on it. Its ``detail`` is one sentence for a person.
"""

import errno
import logging
import sqlite3
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response
from starlette.routing import Match

from dsbrdf import FitError, InvalidArgumentError, MeasurementFormatError

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:dsbrdf:problem:"

# kind -> (status, title)
KINDS: dict[str, tuple[int, str]] = {
    "bad-request": (400, "The request cannot be understood"),
    "bad-encoding": (400, "The body does not decode"),
    "unauthorized": (401, "A valid API key is needed"),
    "storage-quota": (403, "The key's measurements take all the space that it has"),
    "not-found": (404, "There is no such resource"),
    "method-not-allowed": (405, "The resource does not support this method"),
    "not-acceptable": (406, "No acceptable representation"),
    "request-timeout": (408, "The request did not arrive in time"),
    "measurement-in-use": (409, "Unfinished fits use the measurement"),
    "fit-not-finished": (409, "The fit has not finished"),
    "fit-without-result": (409, "The fit has no result"),
    "too-large": (413, "The body is too large"),
    "measurement-too-large": (413, "The file is longer than a MERL measurement"),
    "unsupported-media-type": (415, "The body's type or encoding is not supported"),
    "range-not-satisfiable": (416, "The file has no such part"),
    "measurement-format": (422, "Not an acceptable measurement"),
    "invalid-argument": (422, "An argument is not acceptable"),
    "fit-impossible": (422, "The measurement cannot be fitted with these options"),
    "rate-limited": (429, "Too many requests"),
    "queue-quota": (429, "Too many fits of the key are waiting"),
    "internal": (500, "The service failed"),
    "queue-full": (503, "Too many fits are waiting"),
    "overloaded": (503, "Too many requests are in progress"),
    "shutting-down": (503, "The service is shutting down"),
    "not-ready": (503, "The service is not ready"),
    "disk-full": (507, "The service's disk is full"),
}

_KIND_OF_STATUS = {400: "bad-request", 404: "not-found", 405: "method-not-allowed", 413: "too-large"}
_FULL_DISK = (errno.ENOSPC, errno.EDQUOT)

logger = logging.getLogger(__name__)


class ProblemError(Exception):
    """An error with a place in the table of problems.

    Parameters
    ----------
    kind : str
        A key of `KINDS`.
    detail : str
        One sentence: what is wrong and what would be right.
    headers : mapping, optional
        Further headers of the response.
    """

    def __init__(self, kind: str, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.kind = kind
        self.detail = detail
        self.headers = headers


def response(kind: str, detail: str, path: str, headers: Mapping[str, str] | None = None) -> Response:
    """Return the problem document of `kind` as a response."""
    status, title = KINDS[kind]
    return _document(TYPE_PREFIX + kind, title, status, detail, path, headers)


def install(app: FastAPI) -> None:
    """Make `app` answer every exception with a problem document."""
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(RequestValidationError, _on_validation_error)
    # ServerErrorMiddleware logs what ends here and answers without the stack trace.
    app.add_exception_handler(Exception, _on_exception)
    for expected in (
        ProblemError,
        ClientDisconnect,
        MeasurementFormatError,
        InvalidArgumentError,
        FitError,
        OSError,
        sqlite3.DatabaseError,
    ):
        app.add_exception_handler(expected, _on_exception)


async def _on_exception(request: Request, error: Exception) -> Response:
    path = request.url.path
    if isinstance(error, ProblemError):
        return response(error.kind, error.detail, path, error.headers)
    if isinstance(error, ClientDisconnect):  # seen by the log and the metrics only
        return response("bad-request", "The client went away before the end of the body.", path)
    if isinstance(error, MeasurementFormatError):
        return response("measurement-format", str(error), path)
    if isinstance(error, InvalidArgumentError):
        return response("invalid-argument", str(error), path)
    if isinstance(error, FitError):
        return response("fit-impossible", str(error), path)
    if is_disk_full(error):
        detail = "The service has no disk space left for this request; try again when space has been freed."
        return response("disk-full", detail, path, {"Retry-After": "30"})
    if isinstance(error, (OSError, sqlite3.DatabaseError)):
        logger.error("%s %s: the data folder cannot be used (%s)", request.method, path, error)
        detail = "The service cannot use its data folder at present; its log says why, and /health/ready when it can."
        return response("not-ready", detail, path, {"Retry-After": "10"})
    logger.error("%s %s failed", request.method, path, exc_info=error)
    return response("internal", "The service failed at this request; its log says why.", path)


def is_disk_full(error: BaseException) -> bool:
    """Return whether `error` says that the disk is full."""
    if isinstance(error, OSError):
        return error.errno in _FULL_DISK
    return isinstance(error, sqlite3.OperationalError) and error.sqlite_errorcode == sqlite3.SQLITE_FULL


async def _on_http_exception(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101 (registered for this type only)
    path = request.url.path
    if error.status_code == 404:
        return response("not-found", f"There is nothing at {path}; GET /docs lists what there is.", path)
    if error.status_code == 405:
        allowed = ", ".join(_methods(request))
        detail = f"{request.method} is not supported at {path}; supported: {allowed}."
        return response("method-not-allowed", detail, path, {"Allow": allowed})
    kind = _KIND_OF_STATUS.get(error.status_code)
    if kind is not None:
        return response(kind, f"{error.detail}.".replace("..", "."), path, error.headers)
    title = HTTPStatus(error.status_code).phrase
    return _document("about:blank", title, error.status_code, str(error.detail), path, error.headers)


async def _on_validation_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101 (registered for this type only)
    path = request.url.path
    if any(fault["loc"][0] == "path" for fault in error.errors()):  # an id or label that nothing can have
        return response("not-found", f"There is nothing at {path}; GET /docs lists what there is.", path)
    return response("invalid-argument", sentence(error.errors()), path)


def _methods(request: Request) -> list[str]:
    """Return what the routes of the request's path support, each route being one method."""
    return [
        method
        for method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
        if any(
            route.matches({**request.scope, "method": method})[0] is Match.FULL for route in request.app.router.routes
        )
    ]


def sentence(errors: Sequence[Mapping[str, Any]]) -> str:
    """Return pydantic's list of errors as one sentence."""
    parts = []
    for error in errors[:3]:
        place = ".".join(str(part) for part in error["loc"] if part not in ("body", "query", "path"))
        message = str(error["msg"])
        parts.append(f"{place}: {message[:1].lower()}{message[1:]}" if place else message)
    more = f"; and {len(errors) - 3} more" if len(errors) > 3 else ""
    return "; ".join(parts) + more + "."


def _document(
    type_: str, title: str, status: int, detail: str, path: str, headers: Mapping[str, str] | None
) -> Response:
    content = {"type": type_, "title": title, "status": status, "detail": detail, "instance": path}
    return JSONResponse(content, status, dict(headers or {}), media_type=MEDIA_TYPE)
