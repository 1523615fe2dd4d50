"""Complete the OpenAPI document with bodies, headers, errors and examples that FastAPI does not derive from types."""

import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

import dsbrdf

from ..wire import DEFAULTS
from .messages import JSON
from .problems import KINDS, MEDIA_TYPE, Problem

_TAGS = ("fits", "components", "values", "export", "figures", "measurements", "health")
Responses = dict[int | str, dict[str, Any]]

_REFERENCE = "#/components/schemas/{model}"
_KEY = {
    "type": "http",
    "scheme": "bearer",
    "description": "An API key, made with `dsbrdf keys add`. A service that listens on loopback needs none, unless it "
    "is set to require one; on any other address everyone needs one. A key that is sent is always checked.",
}
_EVERYWHERE = ("bad-request", "head-too-long", "invalid-argument", "internal", "overloaded", "shutting-down")
_BEHIND_A_KEY = ("unauthorized", "foreign-origin", "misdirected", "rate-limited", "too-many-at-once")
BODY_PROBLEMS = ("request-timeout", "unsupported-media-type")
UPLOAD_PROBLEMS = ("storage-quota", "measurement-too-large", "measurement-format", "disk-full", *BODY_PROBLEMS)

_HEADERS = {
    "Location": "Address of the resource.",
    "Link": 'Address of the next page, with `rel="next"`; missing on the last one.',
    "ETag": "Changes with the answer; `If-None-Match` asks whether it has changed.",
    "Retry-After": "Time after which a retry may succeed [s].",
}

EXAMPLE_FIT = "5f2c1d0a9b8e7f6a5c4d3e2f1a0b9c8d"
EXAMPLE_SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
_GIVEN: dict[str, dict[str, Any]] = json.loads((files(__package__) / "examples.json").read_text())
EXAMPLE_POINTS = _GIVEN["points"]
_FIT = {**_GIVEN["fit"], "options": DEFAULTS, "algorithm": dsbrdf.ALGORITHM_VERSION, "library": dsbrdf.__version__}
_EXAMPLES: dict[str, dict[str, Any]] = {
    "MeasurementDocument": _GIVEN["measurement"],
    "MeasurementDetails": {**_GIVEN["measurement"], "fits": [EXAMPLE_FIT]},
    "MeasurementList": {"items": [_GIVEN["measurement"]]},
    "TableDocument": _GIVEN["table"],
    "FitRequest": {"measurement": EXAMPLE_SHA256, "options": {"n_lobes": 3, "horizon_cutoff_deg": 80}},
    "FitDocument": {**_FIT, "components": [_GIVEN["component"]], "model": _GIVEN["model"], **_GIVEN["result"]},
    "FitList": {"items": [_FIT]},
    "RemovedFit": {"id": EXAMPLE_FIT, "status": "cancelled"},
    "ComponentList": {"items": [_GIVEN["component"]]},
    "Values": {"values": [[0.42, 0.21, 0.11]]},
    "MeasuredValues": {"values": [[0.42, 0.21, 0.11], None]},
    "NewName": {"name": "brushed nickel"},
    "Health": {"status": "live", "version": dsbrdf.__version__},
}
EXAMPLE_EVENTS = f"event: succeeded\ndata: {json.dumps(_FIT)}\n\n"


def problems(*kinds: str, behind_a_key: bool = True) -> Responses:
    """Return the responses for problems of these kinds, and for the problems that every operation can have."""
    responses: Responses = {}
    for kind in (*kinds, *_EVERYWHERE, *(_BEHIND_A_KEY if behind_a_key else ())):
        status, title, retry_after = KINDS[kind]
        content = {MEDIA_TYPE: {"schema": reference(Problem)}}
        known = responses.setdefault(status, {"description": title, "content": content})
        if title not in known["description"]:
            known["description"] += f"; or: {title}"
        if retry_after or kind == "rate-limited":
            known |= headers("Retry-After")
    return responses


def headers(*names: str) -> dict[str, Any]:
    """Return the declaration of a response's headers."""
    return {"headers": {name: {"description": _HEADERS[name], "schema": {"type": "string"}} for name in names}}


def answer(description: str, model: type[BaseModel], *names: str) -> dict[str, Any]:
    """Return the declaration of an answer with a document, and with the headers `names`."""
    return {"description": description, "model": model, **headers(*names)}


def body(description: str, content: dict[str, Any]) -> dict[str, Any]:
    """Return the declaration of a request body that FastAPI does not read; `content` has a schema for each type."""
    return {"requestBody": {"required": True, "description": description, "content": content}}


def header_parameter(name: str, description: str, **schema: Any) -> dict[str, Any]:
    """Return the declaration of a request header that FastAPI does not read."""
    return {"name": name, "in": "header", "description": description, "schema": {"type": "string", **schema}}


TAGGED: Responses = {
    200: headers("ETag"),
    304: {"description": "What the client has, by its `If-None-Match`, is current.", **headers("ETag")},
}
"""The answers of a resource that has an ETag."""


def reference(model: type[BaseModel]) -> dict[str, str]:
    """Return a schema that refers to the schema of a model."""
    return {"$ref": _REFERENCE.format(model=model.__name__)}


def file(media_type: str, **schema: Any) -> dict[str, Any]:
    """Return the OpenAPI declaration of a binary body or response."""
    # OpenAPI 3.1 needs only the media type, but client generators read `format`.
    return {"schema": {"type": "string", "format": "binary", "contentMediaType": media_type, **schema}}


def document_of(app: FastAPI, referenced: Sequence[type[BaseModel]]) -> dict[str, Any]:
    """Return the OpenAPI document of `app`, with the schemas of `referenced`, which FastAPI does not find."""
    # Routes are sorted by tag, so that fits come first in the document and in generated pages.
    described = [route for route in app.routes if isinstance(route, APIRoute) and route.tags]
    routes = sorted(described, key=lambda route: _TAGS.index(str(route.tags[0])))
    document = get_openapi(title=app.title, version=app.version, description=app.description, routes=routes)
    models: tuple[type[BaseModel], ...] = (Problem, *referenced)
    _, schemas = models_json_schema([(model, "validation") for model in models], ref_template=_REFERENCE)
    document["components"]["schemas"].update(schemas["$defs"])
    document["components"]["securitySchemes"] = {"key": _KEY}
    document["security"] = [{}, {"key": []}]
    document["servers"] = [{"url": "."}]  # This is relative to the document, which a proxy may show below a prefix.
    document["tags"] = [{"name": name} for name in _TAGS]
    for methods in document["paths"].values():
        for operation in methods.values():
            for part in (operation.get("requestBody", {}), *operation["responses"].values()):
                content = part.get("content", {})
                content.get("text/event-stream", {}).pop("itemSchema", None)  # OpenAPI 3.1 has no such member.
                model = content.get(JSON, {}).get("schema", {}).get("$ref", "").rpartition("/")[2]
                if model in _EXAMPLES:
                    content[JSON]["example"] = _EXAMPLES[model]
    return document


def option_parameter(name: str, schema: dict[str, Any]) -> dict[str, Any]:
    """Return an option as a query parameter of a raw upload: `none` stands for null, commas separate a list.

    The parameter's description names the default. If the schema had a `default`, generated clients would always send
    it, which would contradict the options in a JSON body.
    """
    none = {"type": "string", "enum": ["none"]}
    described = {**schema}
    description, default = described.pop("description"), described.pop("default")
    if "anyOf" in schema:
        described["anyOf"] = [none if choice["type"] == "null" else choice for choice in schema["anyOf"]]
    if default != []:
        word = "none" if default is None else str(default).lower()
        description += f" Default: `{word}`."
    return {"name": name, "in": "query", "explode": False, "description": description, "schema": described}
