"""Parts of the OpenAPI document, for routes to declare to FastAPI: responses, problems, headers, links, raw bodies.

What is true of every operation is added here too: the problems that can occur anywhere, the API key, `X-Request-ID`.
"""

import json
from collections.abc import Sequence
from copy import copy
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic import BaseModel
from starlette.routing import BaseRoute

from service.http import problems as table
from service.wire.schemas import AnglesRequest, DirectionsRequest, FitRequest, MeasurementDetails, Problem, Progress
from service.wire.values import JSON

BINARY = "application/octet-stream"
Responses = dict[int | str, dict[str, Any]]

_REFERENCE = "#/components/schemas/{model}"
# FastAPI does not find these itself.
_REFERENCED = (Problem, FitRequest, AnglesRequest, DirectionsRequest, MeasurementDetails, Progress)
_EXAMPLE_MARK = "example:"
_WITHOUT_KEY = "/health/"
_KEY = {
    "type": "http",
    "scheme": "bearer",
    "description": "An API key, made with `dsbrdf keys add`. From the machine itself no key is needed, unless the "
    "service is set to require one; a key that is sent is always checked.",
}
_EVERYWHERE = ("bad-request", "internal", "overloaded", "shutting-down")
_BEHIND_A_KEY = ("unauthorized", "foreign-origin", "misdirected", "rate-limited", "too-many-at-once")
BODY_PROBLEMS = ("request-timeout", "bad-encoding", "unsupported-media-type")
UPLOAD_PROBLEMS = ("storage-quota", "measurement-too-large", "measurement-format", "disk-full", *BODY_PROBLEMS)

# name -> (description, pattern)
_HEADERS = {
    "X-Request-ID": ("Names the request in the service's log; one that the client sends is kept.", "^[A-Za-z0-9._-]+$"),
    "Location": ("Where the fit or the measurement is.", "/v1/"),
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
_HEADERS_OF_PROBLEMS = {401: ("WWW-Authenticate",), 416: ("Content-Range",)} | dict.fromkeys(
    (429, 503, 507), ("Retry-After",)
)
_OPTIONAL_HEADERS_OF_PROBLEMS = {409: ("Retry-After",), 415: ("Accept-Post", "Accept-Encoding")}


def response(
    description: str,
    example: Any = None,
    *,
    status: int = 200,
    model: type[BaseModel] | None = None,
    content: dict[str, Any] | None = None,
    headers: Sequence[str] = (),
    optional_headers: Sequence[str] = (),
    links: dict[str, Any] | None = None,
) -> Responses:
    """Return a response that is no problem; with an `example` its content is JSON of `model` or of the route's."""
    described: dict[str, Any] = {"description": description, "headers": _headers(headers, optional_headers)}
    if example is not None:
        content = {JSON: {"example": kept(example)} | ({} if model is None else {"schema": reference(model)})}
    if content is not None:
        described["content"] = content
    if links is not None:
        described["links"] = links
    return {status: described}


def problems(*kinds: str, behind_a_key: bool = True) -> Responses:
    """Return the responses for problems of these kinds, and of those that can occur at every operation."""
    responses: Responses = {}
    for kind in (*kinds, *_EVERYWHERE, *(_BEHIND_A_KEY if behind_a_key else ())):
        status, title, detail, _ = table.KINDS[kind]
        headers = _headers(_HEADERS_OF_PROBLEMS.get(status, ()), _OPTIONAL_HEADERS_OF_PROBLEMS.get(status, ()))
        described = responses.setdefault(status, {"description": title, "headers": headers, "content": {}})
        content = described["content"].setdefault(table.MEDIA_TYPE, {"schema": reference(Problem), "examples": {}})
        if title not in described["description"]:
            described["description"] += f"; or: {title}"
        content["examples"][kind] = {"value": table.document(kind, detail, "/v1/fits")}
    return responses


def links(*operations: str, **values: Any) -> dict[str, Any]:
    """Return the links of a response to operations that take `values` of it as parameters."""
    return {operation: {"operationId": operation, "parameters": values} for operation in operations}


def body(description: str, content: dict[str, Any]) -> dict[str, Any]:
    """Return a request body that the service reads itself; `content` by media type."""
    return {"requestBody": {"required": True, "description": description, "content": content}}


def header_parameter(name: str, description: str, example: str | None = None, **schema: Any) -> dict[str, Any]:
    """Return a request header that the service reads itself."""
    shown = {} if example is None else {"example": example}
    schema = {"type": "string", **schema}
    return {"name": name, "in": "header", "required": False, "description": description, "schema": schema, **shown}


def reference(model: type[BaseModel]) -> dict[str, str]:
    """Return the schema that refers to a model's."""
    return {"$ref": _REFERENCE.format(model=model.__name__)}


def file(media_type: str, **schema: Any) -> dict[str, Any]:
    """Return the content of a binary body or response."""
    return {"schema": {"type": "string", "contentMediaType": media_type, **schema}}


def kept(example: Any) -> str:
    """Return an example as text, because FastAPI removes what is null from the document."""
    return _EXAMPLE_MARK + json.dumps(example)


def document_of(app: FastAPI) -> dict[str, Any]:
    """Return the complete OpenAPI document of `app`."""
    routes = [_without_head(route) for route in app.routes]
    document = get_openapi(title=app.title, version=app.version, description=app.description, routes=routes)
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for model in _REFERENCED:
        schema = model.model_json_schema(ref_template=_REFERENCE)
        schemas.update(schema.pop("$defs", {}))
        schemas[model.__name__] = schema
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    components["securitySchemes"] = {"key": _KEY}
    for path, methods in document["paths"].items():
        for operation in methods.values():
            operation["security"] = [] if path.startswith(_WITHOUT_KEY) else [{}, {"key": []}]
            # FastAPI adds these of its own accord; a bad id in the path is answered with 404 here, and a schema of the
            # items of a stream is no part of version 3.1.
            for described in operation["responses"].values():
                described.get("content", {}).get("text/event-stream", {}).pop("itemSchema", None)
            if "HTTPValidationError" in str(operation["responses"].get("422")):
                del operation["responses"]["422"]
    _restore_examples(document["paths"])
    return document


def _without_head(route: BaseRoute) -> BaseRoute:
    """Return a route as it is described: HEAD, which is as GET without a body, is no operation of its own."""
    if not isinstance(route, APIRoute) or route.methods != {"GET", "HEAD"}:
        return route
    described = copy(route)
    described.methods = {"GET"}
    return described


def _restore_examples(node: Any) -> None:
    """Replace the texts that `kept` has made by the examples."""
    if isinstance(node, list):
        for part in node:
            _restore_examples(part)
    elif isinstance(node, dict):
        for key, value in node.items():
            if isinstance(value, str) and value.startswith(_EXAMPLE_MARK):
                node[key] = json.loads(value.removeprefix(_EXAMPLE_MARK))
            else:
                _restore_examples(value)


def _headers(names: Sequence[str], optional: Sequence[str]) -> dict[str, Any]:
    described = {}
    for name in ("X-Request-ID", *names, *optional):
        description, pattern = _HEADERS[name]
        schema = {"type": "string", "pattern": pattern}
        described[name] = {"description": description, "required": name not in optional, "schema": schema}
    return described


NOT_MODIFIED = response("What the client has is current.", status=304, headers=["ETag"])
