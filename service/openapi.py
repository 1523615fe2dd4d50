"""Parts of the OpenAPI document that FastAPI cannot derive: raw bodies, problems, examples."""

import json
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from service import examples
from service.points import ANGLES, DIRECTIONS, NPY
from service.problems import KINDS, MEDIA_TYPE
from service.schemas import AnglesRequest, DirectionsRequest, FitRequest, OptionsDocument, Problem

_COMPONENTS = "#/components/schemas/"
_BODIES = (Problem, FitRequest, AnglesRequest, DirectionsRequest, OptionsDocument)
_BINARY = {"type": "string", "contentMediaType": "application/octet-stream", "maxLength": 34_992_012}

_KEPT = "example:"

Responses = dict[int | str, dict[str, Any]]


def install(app: FastAPI) -> None:
    """Make `app` describe itself completely."""

    def describe() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = get_openapi(
                title=app.title, version=app.version, description=app.description, routes=app.routes, tags=None
            )
            schemas = document.setdefault("components", {}).setdefault("schemas", {})
            for model in _BODIES:
                schema = model.model_json_schema(ref_template=_COMPONENTS + "{model}")
                schemas.update(schema.pop("$defs", {}))
                schemas[model.__name__] = schema
            for path in document["paths"].values():
                for operation in path.values():
                    answers = operation["responses"]
                    # What FastAPI adds of its own accord: a bad id is answered with 404 here.
                    if "HTTPValidationError" in str(answers.get("422")):
                        del answers["422"]
                    answers.update({str(status): entry for status, entry in problems("internal").items()})
            _restore_examples(document["paths"])
            schemas.pop("HTTPValidationError", None)
            schemas.pop("ValidationError", None)
            app.openapi_schema = document
        return app.openapi_schema

    app.openapi = describe  # type: ignore[method-assign]


def example(content: dict[str, Any], description: str, status: int = 200, schema: str | None = None) -> Responses:
    """Return a JSON response with an example; `schema` names its type unless it is that of the route."""
    shown = {"example": _kept(content)} | ({} if schema is None else {"schema": _ref(schema)})
    return {status: {"description": description, "content": {"application/json": shown}}}


def submitted() -> Responses:
    """Return the answers to a submission."""
    known = example(examples.FIT, "The same request was made before; its fit has ended.", 200, "FitDocument")
    later = example(examples.RUNNING_FIT, "The fit has not ended; ask again at `Location`.", 202, "FitDocument")
    return example(examples.FIT, "The fit has ended.", 201) | known | later | problems("invalid-argument")


def fit_submission() -> dict[str, Any]:
    """Return parameters and bodies of a submission."""
    properties = OptionsDocument.model_json_schema()["properties"]
    described = "Option of a raw upload; `none` for null."
    parameters = [
        {"name": name, "in": "query", "required": False, "description": described, "schema": schema}
        for name, schema in properties.items()
    ]
    prefer = {
        "name": "Prefer",
        "in": "header",
        "required": False,
        "description": "`wait=N`: wait at most N seconds for the fit. `respond-async`: do not wait.",
        "schema": {"type": "string"},
        "example": "wait=10",
    }
    document = {"schema": _ref("FitRequest"), "example": examples.SUBMISSION}
    raw = {"schema": _BINARY}
    return {
        "parameters": [*parameters, prefer, _encoding()],
        "requestBody": {
            "required": True,
            "description": "A MERL file, or a reference to a stored measurement.",
            "content": {"application/octet-stream": raw, "application/json": document},
        },
    }


def raw_upload() -> dict[str, Any]:
    """Return the body of an upload."""
    return {
        "parameters": [_encoding()],
        "requestBody": {
            "required": True,
            "description": "A MERL file.",
            "content": {"application/octet-stream": {"schema": _BINARY}},
        },
    }


def point_query() -> dict[str, Any]:
    """Return the parameters that name points."""
    angle = {"type": "array", "items": {"type": "number", "minimum": 0, "maximum": 90}}
    vector = {"type": "array", "items": {"type": "string", "pattern": r"^[^,]+,[^,]+,[^,]+$"}}
    shown = {"theta_half_deg": [10], "theta_diff_deg": [30]}
    unit = "Unit vectors x,y,z on the upper hemisphere; repeat for several points."
    return {
        "parameters": [
            {
                "name": name,
                "in": "query",
                "required": False,
                "explode": True,
                "description": "Angles in degrees; repeat for several points." if name in ANGLES else unit,
                "schema": angle if name in ANGLES else vector,
                **({"example": shown[name]} if name in shown else {}),
            }
            for name in (*ANGLES, *DIRECTIONS)
        ]
    }


def point_batch() -> dict[str, Any]:
    """Return the body of a batch of points."""
    either = {"oneOf": [_ref("AnglesRequest"), _ref("DirectionsRequest")]}
    shown = {"angles": {"value": examples.ANGLES}, "directions": {"value": examples.DIRECTIONS}}
    return {
        "requestBody": {
            "required": True,
            "description": "Points, in degrees or as unit vectors.",
            "content": {"application/json": {"schema": either, "examples": shown}, NPY: {"schema": _npy()}},
        }
    }


def batch_answer() -> Responses:
    """Return the answer to a batch of points."""
    content = {"application/json": {"example": examples.VALUES}, NPY: {"schema": _npy()}}
    return {200: {"description": "One RGB triple for each point.", "content": content}}


def binary(media_type: str, description: str) -> Responses:
    """Return a response that is a file."""
    schema = {"type": "string", "contentMediaType": media_type}
    return {200: {"description": description, "content": {media_type: {"schema": schema}}}}


def events() -> Responses:
    """Return the response that is a stream of events."""
    content = {"text/event-stream": {"schema": {"type": "string"}, "example": examples.EVENTS}}
    return {200: {"description": "Events until the fit has ended.", "content": content}}


def health(status: str) -> Responses:
    """Return the answer of a health check."""
    return example({"status": status, "version": examples.FIT["library"]}, f"The service is {status}.")


def _kept(content: dict[str, Any]) -> str:
    """Return an example as text, because FastAPI drops what is null from the document."""
    return _KEPT + json.dumps(content)


def _restore_examples(node: Any) -> None:
    """Put the examples that `_kept` has wrapped back in place."""
    if isinstance(node, list):
        for part in node:
            _restore_examples(part)
    elif isinstance(node, dict):
        for key, value in node.items():
            if isinstance(value, str) and value.startswith(_KEPT):
                node[key] = json.loads(value.removeprefix(_KEPT))
            else:
                _restore_examples(value)


def problems(*kinds: str) -> Responses:
    """Return the responses for problems of these kinds."""
    responses: Responses = {}
    for kind in kinds:
        status, title = KINDS[kind]
        entry = responses.setdefault(status, {"description": title, "content": {}})
        if entry["description"] != title:
            entry["description"] += f"; or: {title}"
        content = entry["content"].setdefault(MEDIA_TYPE, {"schema": _ref("Problem"), "examples": {}})
        content["examples"][kind] = {"value": examples.problem(kind, status, title)}
    return responses


def _encoding() -> dict[str, Any]:
    return {
        "name": "Content-Encoding",
        "in": "header",
        "required": False,
        "description": "The body may be compressed.",
        "schema": {"type": "string", "enum": ["identity", "gzip", "zstd"]},
    }


def _npy() -> dict[str, Any]:
    return {"type": "string", "contentMediaType": NPY}


def _ref(name: str) -> dict[str, str]:
    return {"$ref": _COMPONENTS + name}
