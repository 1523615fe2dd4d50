"""Define the errors that the service raises; `http.problems` turns these and other errors into answers."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

_PLAIN_WORDS = {  # Plain words replace each of these patterns in pydantic's messages.
    r", unable to [^,]*| after validation": "",
    r"^(Input|String|List|Value) should (be|have|match) ": r"must \2 ",
    r"^Value error, ": "",
    r"^Field required$": "is missing",
    r"^Invalid JSON: ": "The body is not JSON: ",
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    r"a valid (array|list)\b": "a list",
    r"a valid boolean\b": "true or false",
    r"a valid integer\b": "a whole number",
    r"a valid string\b": "a text",
}


class DSBRDFServiceError(Exception):
    """Base of every error that the service raises on purpose."""


class DataFolderError(DSBRDFServiceError):
    """The data folder cannot be opened; the message says why."""


class DatabaseLostError(DSBRDFServiceError, OSError):
    """The database's file has been removed or replaced, so further writes would be lost at the end of this process."""


class ProblemError(DSBRDFServiceError):
    """The request cannot be fulfilled; the client gets a problem document.

    `kind` is a key of `http.problems.KINDS`, which has the HTTP status. `detail` is one sentence with the mistake
    and the remedy. `headers` are added to the response.
    """

    def __init__(self, kind: str, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.kind = kind
        self.detail = detail
        self.headers = dict(headers or {})


class InvalidKeyError(ProblemError):
    """The key of a request is wrong or revoked."""

    def __init__(self) -> None:
        detail = "The Authorization header holds no valid API key; send one key as 'Authorization: Bearer <key>'."
        super().__init__("unauthorized", detail, {"WWW-Authenticate": 'Bearer error="invalid_token"'})


class FitNotFoundError(ProblemError):
    """The caller has no fit with this id."""

    def __init__(self, fit_id: str) -> None:
        super().__init__("not-found", f"There is no fit {fit_id[:64]!r}; GET /v1/fits lists your fits.")


class MeasurementNotFoundError(ProblemError):
    """The caller has no measurement with this sha256."""

    def __init__(self, sha256: str) -> None:
        remedy = "upload it with POST /v1/measurements or POST /v1/fits"
        super().__init__("not-found", f"There is no measurement {sha256[:64]!r}; {remedy}.")


class MeasurementDamagedError(ProblemError):
    """The file of a measurement is missing, or its sha256 is wrong, so the measurement must be uploaded again."""

    def __init__(self, damage: str) -> None:
        super().__init__("measurement-damaged", f"The stored measurement is damaged ({damage}); upload it again.")


def validation_sentence(errors: Sequence[Mapping[str, Any]], known: Iterable[str] = ()) -> str:
    """Return pydantic's list of errors as one sentence, with the values that were sent and the `known` members."""
    unknown = [error["loc"][-1] for error in errors if error["type"] == "extra_forbidden"]
    if unknown:  # Only this error is reported, because a misspelt name also causes an error about a missing name.
        return f"Unknown {min(unknown)[:60]!r}; known are {', '.join(known)}."
    parts = []
    for error in errors[:3]:
        place = ".".join(str(part) for part in error["loc"] if part not in ("body", "query", "path"))
        message = error["msg"]
        for pattern, words in _PLAIN_WORDS.items():
            message = re.sub(pattern, words, message)
        if isinstance(error["input"], str | int | float) and message.startswith("must "):
            message += f", not {repr(error['input'])[:60]}"
        if message.startswith(("must ", "is ")):
            parts.append(f"{place or 'The body'} {message}")
        else:
            parts.append(f"{place}: {message}" if place else message)
    more = f"; and {len(errors) - 3} more" if len(errors) > 3 else ""
    return "; ".join(parts) + more + "."
