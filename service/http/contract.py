"""What is true of every operation in the OpenAPI document: names, keys, problems, headers, links to what follows."""

from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute

from service.http.openapi import COMPONENTS, add_problems, restore_examples
from service.wire.schemas import AnglesRequest, DirectionsRequest, FitRequest, Problem, Progress

_BODIES = (Problem, FitRequest, AnglesRequest, DirectionsRequest, Progress)
_OPEN = "/health/"  # what needs no key
_KEY = {
    "type": "http",
    "scheme": "bearer",
    "description": "An API key, made with `dsbrdf keys add`. From the machine itself no key is needed, unless the "
    "service is told to want one; a key that is sent is always checked.",
}
_ANYWHERE = ("bad-request", "internal", "overloaded", "shutting-down")
_BEHIND_A_KEY = ("unauthorized", "rate-limited")
_WITH_A_BODY = ("request-timeout", "bad-encoding", "unsupported-media-type")
_WRITING = ("disk-full",)  # of the database, also where something is removed
_PROBLEMS_OF_OPERATION = {
    "submit_fit": ("storage-quota", "invalid-argument", "queue-quota"),
    "upload_measurement": ("storage-quota",),
    "download_measurement": ("range-not-satisfiable",),
}

# What headers say. Below, an exclamation mark stands behind those that are always there.
_HEADERS: dict[str, tuple[str, str]] = {
    "X-Request-ID": ("Names the request in the service's log; one that the client sends is kept.", "^[A-Za-z0-9._-]+$"),
    "Location": ("Where the fit or the measurement is.", "^/v1/"),
    "Retry-After": ("Time after which to ask again [s].", "^[0-9]+$"),
    "ETag": ("Strong validator of the content, for `If-None-Match`.", '^"[0-9a-f]+"$'),
    "Link": ('The next page, `rel="next"`; not on the last one.', 'rel="next"$'),
    "WWW-Authenticate": ("How to send a key.", "^Bearer"),
    "Accept-Ranges": ("A part of the file can be asked for with `Range`.", "^bytes$"),
    "Content-Range": ("The part that is sent, and the size of the whole.", "^bytes "),
    "Content-Length": ("Size of the file [bytes].", "^[0-9]+$"),
    "Content-Disposition": ("A name for the file.", "^attachment"),
    "Accept-Post": ("The types of body that are supported.", "/"),
    "Accept-Encoding": ("The encodings of a body that are supported.", "gzip"),
}
_HEADERS_OF_STATUS = {
    "401": "WWW-Authenticate!",
    "409": "Retry-After",
    "415": "Accept-Post Accept-Encoding",
    "416": "Content-Range!",
    "429": "Retry-After!",
    "503": "Retry-After!",
    "507": "Retry-After!",
}
_HEADERS_OF_OPERATION: dict[str, dict[str, str]] = {
    "submit_fit": {"200": "Location!", "201": "Location!", "202": "Location! Retry-After!"},
    "upload_measurement": {"200": "Location! ETag!", "201": "Location! ETag!"},
    "list_fits": {"200": "Link"},
    "list_measurements": {"200": "Link"},
    "get_fit": {"200": "ETag! Retry-After", "304": "ETag!"},
    "get_components": {"200": "ETag!", "304": "ETag!"},
    "download_measurement": {
        "200": "ETag! Accept-Ranges! Content-Disposition!",
        "206": "ETag! Content-Range! Content-Disposition!",
        "304": "ETag!",
    },
    "probe_measurement": {"200": "ETag! Content-Length!"},
    "export_fit": {"200": "Content-Disposition!"},
}

_NOT_FOR_EVERY_ROUTE = {"206": "The part of the file that was asked for.", "304": "What the client has is still so."}
_CONDITION = {
    "name": "If-None-Match",
    "in": "header",
    "required": False,
    "description": "The `ETag` of what the client has.",
    "schema": {"type": "string"},
}
_RANGE = {
    "name": "Range",
    "in": "header",
    "required": False,
    "description": "One range of bytes; what is no such range is ignored (RFC 9110).",
    "schema": {"type": "string"},
    "example": "bytes=0-11",
}

_FIT = {"parameters": {"fit_id": "$response.body#/id"}}
_MEASUREMENT = {"parameters": {"sha256": "$response.body#/sha256"}}
# operation -> (statuses with links, operations that they lead to, what these are given)
_LINKS: dict[str, tuple[tuple[str, ...], tuple[str, ...], dict[str, Any]]] = {
    "submit_fit": (
        ("200", "201", "202"),
        ("get_fit", "follow_fit", "get_values", "post_values", "get_components", "export_fit", "delete_fit"),
        _FIT,
    ),
    "upload_measurement": (
        ("200", "201"),
        ("download_measurement", "probe_measurement", "delete_measurement"),
        _MEASUREMENT,
    ),
    "get_fit": (("200",), ("get_values", "get_components", "export_fit", "delete_fit"), _FIT),
    "list_measurements": (
        ("200",),
        ("submit_fit",),
        {
            "requestBody": {
                "measurement": "$response.body#/items/0/sha256",
                "options": {"method": "paper", "n_lobes": 1},
            }
        },
    ),
}


def install(app: FastAPI) -> None:
    """Make `app` describe itself completely."""

    def describe() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app)
        return app.openapi_schema

    app.openapi = describe  # type: ignore[method-assign]


def operation_id(route: APIRoute) -> str:
    """Return the name of a route's operation, which links lead to and generated clients have: its function's."""
    return route.name


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for model in _BODIES:
        schema = model.model_json_schema(ref_template=COMPONENTS + "{model}")
        schemas.update(schema.pop("$defs", {}))
        schemas[model.__name__] = schema
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    components["securitySchemes"] = {"key": _KEY}
    for path, method, operation in _operations(document):
        _complete(path, method, operation)
    restore_examples(document["paths"])
    return document


def _operations(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def _complete(path: str, method: str, operation: dict[str, Any]) -> None:
    """Add to an operation what does not depend on what it does."""
    answers: dict[str, Any] = operation["responses"]
    # What FastAPI adds of its own accord: a bad id is answered with 404 here.
    if "HTTPValidationError" in str(answers.get("422")):
        del answers["422"]
    behind_a_key = not path.startswith(_OPEN)
    operation["security"] = [{}, {"key": []}] if behind_a_key else []
    name = operation["operationId"]
    headers = _HEADERS_OF_OPERATION.get(name, {})
    for status, description in _NOT_FOR_EVERY_ROUTE.items():
        if status in headers:
            answers[status] = {"description": description}
            operation.setdefault("parameters", []).append(_RANGE if status == "206" else _CONDITION)
    add_problems(answers, *_PROBLEMS_OF_OPERATION.get(name, ()))
    add_problems(answers, *_ANYWHERE, *(_BEHIND_A_KEY if behind_a_key else ()))
    if "requestBody" in operation:
        add_problems(answers, *_WITH_A_BODY)
    if method in ("delete", "post") and "brdf" not in path:
        add_problems(answers, *_WRITING)
    for status, answer in answers.items():
        own = headers.get(status, "")
        for marked in f"X-Request-ID! {own} {_HEADERS_OF_STATUS.get(status, '')}".split():
            answer.setdefault("headers", {})[marked.rstrip("!")] = _header(marked)
    statuses, followers, given = _LINKS.get(name, ((), (), {}))
    for status in statuses:
        answers[status]["links"] = {follower: {"operationId": follower, **given} for follower in followers}


def _header(marked: str) -> dict[str, Any]:
    name = marked.rstrip("!")
    description, pattern = _HEADERS[name]
    schema = {"type": "string", "pattern": pattern}
    return {"description": description, "required": marked.endswith("!"), "schema": schema}
