"""Define the JSON documents and the queries that clients send, as pydantic models.

Angles are in degrees (``_deg``), and channels are in the order red, green, blue.
"""

import json
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, TypeVar
from urllib.parse import urlencode

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, WithJsonSchema
from starlette.requests import Request

from dsbrdf.components.shares import LABELS
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.options import FitOptions, sentences_of
from dsbrdf.samples.table_options import TableOptions

from ..errors import validation_sentence
from ..http.messages import prefix_of
from ..storage.schema import FitRow, MeasurementRow
from ..wire import DEFAULTS, TABLE_DEFAULTS

FIT_ID = r"^[0-9a-f]{32}$"
SHA256 = r"^[0-9a-f]{64}$"
_TIME_MEMBERS = ("created", "started", "finished")
Label = Literal[*LABELS]  # type: ignore[valid-type]
Share = Annotated[float, Field(ge=0, le=1)]
Rgb = Annotated[list[float], Field(min_length=3, max_length=3)]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Name = Annotated[str | None, Field(description="The latest name given; no part of the identity.")]


def _check_plain(given: Any) -> Any:
    """Return the input; raise ValueError for texts such as 1_000 or " 1", which are numbers only in Python."""
    if isinstance(given, str) and ("_" in given or not given.isascii() or given.strip() != given):
        raise ValueError(f"{given[:40]!r} is not a number")
    return given


PLAIN = BeforeValidator(_check_plain)
"""Validator that refuses texts such as 1_000 as numbers in a query; an annotation lists it after the limits."""


class Document(BaseModel):
    """A JSON document of the service; the text below a member is its description in OpenAPI."""

    model_config = ConfigDict(use_attribute_docstrings=True)


class Input(Document):
    """A document that clients send; an unknown member is an error."""

    model_config = ConfigDict(extra="forbid")


def _options_schema(kind: type, defaults: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON schema of options, with types, bounds and descriptions from the library's dataclass."""
    declared = TypeAdapter(kind).json_schema()["properties"]
    for name, example in (("columns", "theta_in=AOI"), ("constants", "theta_in=30")):
        pair = {"type": "string", "pattern": r"^[^=]*[^=\s][^=]*=.*\S", "examples": [example]}
        declared[name] = {"title": "", "type": "array", "items": pair}
    sentences = sentences_of(kind)
    properties = {}
    for name, default in defaults.items():
        schema = declared[name]
        del schema["title"]
        for choice in schema.get("anyOf", ()):
            if "const" in choice:  # Few client generators understand `const`, so an enum of one value replaces it.
                choice["enum"] = [choice.pop("const")]
        properties[name] = {**schema, "default": default, "description": sentences[name]}
    description = "What is not given is the default."
    head = {"type": "object", "title": kind.__name__, "description": description, "additionalProperties": False}
    return {**head, "properties": properties}


OPTIONS_SCHEMA = _options_schema(FitOptions, DEFAULTS)
TABLE_SCHEMA = _options_schema(TableOptions, TABLE_DEFAULTS)
Options = Annotated[dict[str, Any], WithJsonSchema(OPTIONS_SCHEMA)]
_Document = TypeVar("_Document", bound=BaseModel)


def parse(kind: type[_Document], body: bytes) -> _Document:
    """Parse a JSON body as a document of a `kind`.

    Raises InvalidArgumentError if the body is not a document of this kind.
    """
    try:
        document = kind.model_validate_json(body)
    except ValidationError as error:
        raise InvalidArgumentError(validation_sentence(error.errors(), kind.model_fields)) from None
    json.loads(body, object_pairs_hook=_refuse_repetition)
    return document


def _refuse_repetition(members: list[tuple[str, Any]]) -> None:
    """Raise InvalidArgumentError if an object has two members of one name, because it is unclear which one counts."""
    for name, count in Counter(name for name, _ in members).items():
        if count > 1:
            raise InvalidArgumentError(f"The member {name[:60]!r} is given more than once; give it once.")


class Page(Input):
    """Query parameters of a page of a list."""

    limit: Annotated[int, Field(ge=1, le=200, description="Items in the answer."), PLAIN] = 50
    cursor: Annotated[int | None, Field(ge=0, lt=10**18, description="From the `Link` of the page before."), PLAIN] = (
        None
    )
    name: Annotated[str | None, Field(description="Only what has this name.")] = None


def members(document: type[BaseModel], row: FitRow | MeasurementRow) -> dict[str, Any]:
    """Return the values of a database row for the members of a document; times are converted to datetimes."""
    known = {name: getattr(row, name) for name in document.model_fields if hasattr(row, name)}
    times = {name: datetime.fromtimestamp(known[name], UTC) for name in _TIME_MEMBERS if known.get(name) is not None}
    return known | times


def next_page(request: Request, page: Page, rows: Sequence[FitRow | MeasurementRow]) -> dict[str, str]:
    """Return the ``Link`` header to the next page, if `rows` has more rows than the page; otherwise no header."""
    if len(rows) <= page.limit:
        return {}
    query = urlencode(page.model_dump(exclude_none=True) | {"cursor": rows[page.limit - 1].seq})
    return {"Link": f'<{prefix_of(request)}{request.url.path}?{query}>; rel="next"'}
