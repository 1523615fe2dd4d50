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

from dsbrdf.data.table_options import sentences_of
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.layer_shares import LABELS
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.render import LIGHTINGS
from dsbrdf.output.export import FORMATS, LAYERS, PARTS

from ..errors import validation_sentence
from .fit_options import DEFAULTS
from .names import MAX_LENGTH

_Given = TypeVar("_Given")
FIT_ID = r"^[0-9a-f]{32}$"
SHA256 = r"^[0-9a-f]{64}$"
Label = Literal[*LABELS]  # type: ignore[valid-type]
_Component = Annotated[Label | None, Field(description="One component instead of the whole fit.")]


def _check_plain(text: _Given) -> _Given:
    """Return what is given; raise ValueError if it is a text that only Python takes for a number."""
    if isinstance(text, str) and ("_" in text or not text.isascii()):
        raise ValueError(f"{text[:40]!r} is no number")
    return text


def _or_one(schema: dict[str, Any]) -> None:
    """Add to the schema of a list that one of its items may stand for it."""
    schema["anyOf"] = [{"type": schema.pop("type"), "items": schema["items"]}, schema.pop("items")]


Plain = BeforeValidator(_check_plain)
"""Stands after the limits of a number in a query or a path, and refuses what only Python reads as one: 1_000."""
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

    limit: Annotated[int, Field(ge=1, le=200, description="Items in the answer."), Plain] = 50
    cursor: Annotated[
        str | None, Field(pattern=r"^[0-9]{1,18}$", description="From the `Link` of the page before.")
    ] = None
    name: Annotated[str | None, Field(description="Only what has this name.")] = None

    @property
    def before(self) -> int | None:
        """Number of the row from which the page goes on."""
        return None if self.cursor is None else int(self.cursor)


class Waiting(Input):
    """How long to wait for a fit."""

    wait: Annotated[
        float,
        Field(ge=0, allow_inf_nan=False, description="Answer when the fit has ended, or after this time [s]."),
        Plain,
    ] = 0.0


class Removal(Input):
    """What a DELETE of a fit is to do."""

    only: Annotated[
        Literal["cancel", "delete"] | None,
        Field(description="`cancel` refuses a fit that has ended, `delete` one that has not; otherwise what applies."),
    ] = None


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


class Picture(Input):
    """How large to draw."""

    size: Annotated[int, Field(ge=8, le=256, description="Pixels along a side."), Plain] = 128


class FitPicture(Picture):
    """What of a fit to draw, and how large."""

    component: _Component = None


class Sphere(Picture):
    """What to draw."""

    lighting: Annotated[
        Literal[*LIGHTINGS],  # type: ignore[valid-type]
        Field(description="Three lights, or a sky with sun and window."),
    ] = "three_lights"


class FitSphere(Sphere):
    """What of a fit to draw."""

    component: _Component = None


class Figure(Input):
    """How to draw a figure."""

    dark: Annotated[bool, Field(description="For a dark background.")] = False


class NewName(Input):
    """Another name of a fit, or none."""

    name: Annotated[str | None, Field(max_length=MAX_LENGTH, description="null takes the name away.")]
