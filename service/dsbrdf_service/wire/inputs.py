"""The JSON documents and the queries that clients send, as pydantic models.

Angles in degrees (``_deg``), RGB order.
"""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import PydanticCustomError

from dsbrdf.components.shares import LABELS
from dsbrdf.data.table_options import sentences_of
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.output.export import FORMATS, LAYERS, PARTS

from ..errors import validation_sentence
from .fit_options import DEFAULTS
from .names import MAX_LENGTH

FIT_ID = r"^[0-9a-f]{32}$"
SHA256 = r"^[0-9a-f]{64}$"
Label = Literal[*LABELS]  # type: ignore[valid-type]


def _or_one(schema: dict[str, Any]) -> None:
    """Add to the schema of a list that one of its items may stand for it."""
    schema["anyOf"] = [{"type": schema.pop("type"), "items": schema["items"]}, schema.pop("items")]


def _check_plain(given: Any) -> Any:
    """Return what is given; raise ValueError if it is a text that only Python takes for a number."""
    if isinstance(given, str) and ("_" in given or not given.isascii()):
        raise ValueError(f"{given[:40]!r} is no number")
    return given


PLAIN = BeforeValidator(_check_plain)
"""Stands after the limits of a number in a query, and refuses what only Python reads as one: 1_000."""
_Number = Annotated[float, Field(allow_inf_nan=False)]
_Angle = Annotated[float, Field(ge=0, le=90, allow_inf_nan=False)]
_Angles = Annotated[list[_Angle], Field(json_schema_extra=_or_one)]
_Turns = Annotated[list[_Number], Field(json_schema_extra=_or_one)]
_Vectors = Annotated[
    list[Annotated[list[_Number], Field(min_length=3, max_length=3)]],
    Field(description="Unit vectors; values are 0 where one is below the horizon (z < 0)."),
]


class Input(BaseModel):
    """A document that clients send: what it does not know is an error, not ignored."""

    model_config = ConfigDict(extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_members(cls, given: Any) -> Any:
        if isinstance(given, dict) and (unknown := given.keys() - cls.model_fields.keys()):
            told = {"name": repr(str(min(unknown))[:60]), "known": ", ".join(cls.model_fields)}
            raise PydanticCustomError("unknown", "Unknown {name}; known are {known}", told)
        return given


def _options_schema() -> dict[str, Any]:
    """Return the schema of the options: the types, bounds and sentences of the library's dataclass."""
    declared = TypeAdapter(FitOptions).json_schema()["properties"]
    column = {"type": "string", "pattern": r"^[^=]*[^=\s][^=]*=.*\S", "examples": ["theta_in=AOI"]}
    declared["columns"] = {"title": "", "type": "array", "items": column}
    sentences = sentences_of(FitOptions)
    properties = {}
    for name, default in DEFAULTS.items():
        schema = declared[name]
        del schema["title"]
        for choice in schema.get("anyOf", ()):
            if "const" in choice:  # which fewer generators of clients know
                choice["enum"] = [choice.pop("const")]
        properties[name] = {**schema, "default": default, "description": sentences[name]}
    description = "Options of a fit; what is not given is the default."
    head = {"type": "object", "title": "FitOptions", "description": description, "additionalProperties": False}
    return {**head, "properties": properties}


OPTIONS_SCHEMA = _options_schema()
Options = Annotated[dict[str, Any], WithJsonSchema(OPTIONS_SCHEMA)]
_Document = TypeVar("_Document", bound=BaseModel)


def parse_document(kind: type[_Document], body: bytes) -> _Document:
    """Return the document of a JSON body.

    Raises InvalidArgumentError if the body is not such a document.
    """
    try:
        return kind.model_validate_json(body)
    except ValidationError as error:
        raise InvalidArgumentError(validation_sentence(error.errors())) from None


class FitRequest(Input):
    """A fit of a stored measurement."""

    measurement: Annotated[str, Field(pattern=SHA256, description="The measurement's sha256.")]
    options: Options = {}


class AnglesRequest(Input):
    """Points by half and difference angles in degrees; one angle counts for all points."""

    theta_half_deg: Annotated[_Angles, Field(examples=[[10]])]
    theta_diff_deg: Annotated[_Angles, Field(examples=[[30]])]
    phi_diff_deg: Annotated[
        _Turns, Field(description="90 where it is left out: both directions at one angle to the normal.")
    ] = [90.0]


class SidesRequest(Input):
    """Points by the angles of both directions to the normal, and about it, in degrees; one counts for all points."""

    theta_in_deg: _Angles
    theta_out_deg: _Angles
    phi_in_deg: _Turns = [0.0]
    phi_out_deg: Annotated[_Turns, Field(description="180, the side of the mirror direction, where left out.")] = [
        180.0
    ]


class DirectionsRequest(Input):
    """Points by pairs of unit vectors; the surface's normal is (0, 0, 1)."""

    omega_in: _Vectors
    omega_out: _Vectors


class Page(Input):
    """Which part of a list."""

    limit: Annotated[int, Field(ge=1, le=200, description="Items in the answer."), PLAIN] = 50
    cursor: Annotated[
        str | None, Field(pattern=r"^[0-9]{1,18}$", description="From the `Link` of the page before.")
    ] = None
    name: Annotated[str | None, Field(description="Only what has this name.")] = None

    @property
    def before(self) -> int | None:
        """Number of the row from which the page goes on."""
        return None if self.cursor is None else int(self.cursor)


class Export(Input):
    """What to export."""

    format: Annotated[
        Literal[*FORMATS],  # type: ignore[valid-type]
        Field(description="; ".join(f"`{name}`: {kind.purpose}" for name, kind in FORMATS.items()) + "."),
    ]
    component: Annotated[
        Literal[*PARTS] | None,  # type: ignore[valid-type]
        Field(
            description="One component instead of the whole fit, in a format that holds values or a shader; or "
            f"`{LAYERS}`, the layers of all components as a small model, in any format."
        ),
    ] = None
    name: Annotated[
        str | None, Field(description="Of the function in `glsl`; all other names in the file begin with it.")
    ] = None
    sampling: Annotated[bool, Field(description="Add functions to `glsl` that draw directions.")] = False


class NewName(Input):
    """Another name of a fit, or none."""

    name: Annotated[str | None, Field(max_length=MAX_LENGTH, description="null takes the name away.")]
