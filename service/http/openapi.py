"""Parts of the OpenAPI document that FastAPI cannot derive: raw bodies, problems, examples."""

import json
from typing import Any

from service.http import examples
from service.http.problems import KINDS, MEDIA_TYPE
from service.wire.points import ANGLES, DIRECTIONS, NPY
from service.wire.schemas import OptionsDocument, Progress

COMPONENTS = "#/components/schemas/"
_BINARY = {"type": "string", "contentMediaType": "application/octet-stream", "maxLength": 34_992_012}

_KEPT = "example:"

Responses = dict[int | str, dict[str, Any]]


def example(content: dict[str, Any], description: str, status: int = 200, schema: str | None = None) -> Responses:
    """Return a JSON response with an example; `schema` names its type unless it is that of the route."""
    shown = {"example": _kept(content)} | ({} if schema is None else {"schema": _ref(schema)})
    return {status: {"description": description, "content": {"application/json": shown}}}


def submitted() -> Responses:
    """Return the answers to a submission."""
    known = example(examples.FIT, "The same request was made before; its fit has ended.", 200, "FitDocument")
    later = example(examples.RUNNING_FIT, "The fit has not ended; ask again at `Location`.", 202, "FitDocument")
    return example(examples.FIT, "The fit has ended.", 201) | known | later


def fit_submission() -> dict[str, Any]:
    """Return parameters and bodies of a submission."""
    properties = OptionsDocument.model_json_schema()["properties"]
    parameters = [_option(name, schema) for name, schema in properties.items()]
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


def _option(name: str, schema: dict[str, Any]) -> dict[str, Any]:
    """Return an option as a query parameter: `none` for null, and a list with commas."""
    none = {"type": "string", "const": "none"}
    choices = [none if choice.get("type") == "null" else choice for choice in schema.get("anyOf", ())]
    default = "none" if schema["default"] is None else schema["default"]
    return {
        "name": name,
        "in": "query",
        "style": "form",
        "explode": False,
        "description": "Option of a raw upload.",
        "schema": {**schema, "default": default} | ({"anyOf": choices} if choices else {}),
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
    data = {"type": "string", "contentMediaType": "application/json", "contentSchema": _ref("Progress")}
    event = {
        "type": "object",
        "properties": {"event": Progress.model_json_schema()["properties"]["status"], "data": data},
        "required": ["event", "data"],
    }
    content = {"text/event-stream": {"itemSchema": event, "example": examples.EVENTS}}
    return {200: {"description": "Events until the fit has ended.", "content": content}}


def export() -> Responses:
    """Return the response that is a model's file."""
    binary_file = {"schema": {"type": "string", "contentMediaType": "application/octet-stream"}}
    json_file = {"schema": {"type": "object"}, "example": _kept(examples.STORED_MODEL)}
    content = {"application/octet-stream": binary_file, "application/json": json_file}
    return {200: {"description": "The file: JSON for `json`, bytes for the other formats.", "content": content}}


def health(status: str) -> Responses:
    """Return the answer of a health check."""
    return example({"status": status, "version": examples.FIT["library"]}, f"The service is {status}.")


def _kept(content: dict[str, Any]) -> str:
    """Return an example as text, because FastAPI drops what is null from the document."""
    return _KEPT + json.dumps(content)


def restore_examples(node: Any) -> None:
    """Put the examples that `_kept` has wrapped back in place."""
    if isinstance(node, list):
        for part in node:
            restore_examples(part)
    elif isinstance(node, dict):
        for key, value in node.items():
            if isinstance(value, str) and value.startswith(_KEPT):
                node[key] = json.loads(value.removeprefix(_KEPT))
            else:
                restore_examples(value)


def problems(*kinds: str) -> Responses:
    """Return the responses for problems of these kinds."""
    responses: Responses = {}
    add_problems(responses, *kinds)
    return responses


def add_problems(responses: dict[Any, Any], *kinds: str) -> None:
    """Add the problems of these kinds to responses, by statuses of the type that the first one has."""
    as_text = any(isinstance(status, str) for status in responses)
    for kind in kinds:
        status, title = KINDS[kind]
        entry = responses.setdefault(str(status) if as_text else status, {"description": title})
        content = entry.setdefault("content", {}).setdefault(MEDIA_TYPE, {"schema": _ref("Problem"), "examples": {}})
        if title not in entry["description"]:
            entry["description"] += f"; or: {title}"
        content["examples"][kind] = {"value": examples.problem(kind, status, title)}


def _encoding() -> dict[str, Any]:
    return {
        "name": "Content-Encoding",
        "in": "header",
        "required": False,
        "description": "The body may be compressed.",
        "schema": {"type": "string", "enum": ["identity", "gzip", "x-gzip", "zstd"]},
    }


def _npy() -> dict[str, Any]:
    return {"type": "string", "contentMediaType": NPY}


def _ref(name: str) -> dict[str, str]:
    return {"$ref": COMPONENTS + name}
