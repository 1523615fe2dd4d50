"""The JSON documents as pydantic models, made from rows of the store and from models.

Angles in degrees (``_deg``), BRDF values in 1/sr, RGB order.
"""

import inspect
import re
from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
    computed_field,
    model_validator,
)
from pydantic_core import PydanticCustomError

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.layer_shares import LABELS
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.render import LIGHTINGS
from dsbrdf.output.export import FORMATS, LAYERS, PARTS
from dsbrdf.output.report_text import likeness

from ..errors import validation_sentence
from ..storage.schema import FitRow, MeasurementRow, Status
from .fit_options import DEFAULTS
from .names import MAX_LENGTH
from .numbers import check_plain

FIT_ID = r"^[0-9a-f]{32}$"
SHA256 = r"^[0-9a-f]{64}$"

Share = Annotated[float, Field(ge=0, le=1)]
Plain = BeforeValidator(check_plain)
"""Stands after the limits of a number in a query or a path, and refuses what only Python reads as one: 1_000."""
Number = Annotated[float, Field(allow_inf_nan=False)]
Rgb = Annotated[list[float], Field(min_length=3, max_length=3)]
Name = Annotated[str | None, Field(description="The latest name given; no part of the identity.")]
_Label = Literal[*LABELS]  # type: ignore[valid-type]
_Component = Annotated[_Label | None, Field(description="One component instead of the whole fit.")]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]


class _Input(BaseModel):
    """A document that clients send: what it does not know is an error, not ignored."""

    model_config = ConfigDict(extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_members(cls, given: Any) -> Any:
        unknown = [] if not isinstance(given, dict) else [name for name in given if name not in cls.model_fields]
        if unknown:
            known = ", ".join(cls.model_fields)
            raise PydanticCustomError(
                "unknown", "Unknown {name}; known are {known}", {"name": repr(str(unknown[0])[:60]), "known": known}
            )
        return given


def _options_schema() -> dict[str, Any]:
    """Return the schema of the options: the types, bounds and sentences of the library's dataclass."""
    declared = TypeAdapter(FitOptions).json_schema()["properties"]
    stated = inspect.getdoc(FitOptions) or ""  # indented alike in all versions of Python, as __doc__ is not
    sentences = dict(re.findall(r"^(\w+) : .*\n((?: {4}.*\n)+)", stated, re.MULTILINE))
    properties = {}
    for name, default in DEFAULTS.items():
        schema = declared[name]
        del schema["title"]
        description = " ".join(sentences[name].split())
        properties[name] = {**schema, "default": default, "description": description}
    description = "Options of a fit; what is not given is the default."
    head = {"type": "object", "title": "FitOptions", "description": description, "additionalProperties": False}
    return {**head, "properties": properties}


OPTIONS_SCHEMA = _options_schema()
_Options = Annotated[dict[str, Any], WithJsonSchema(OPTIONS_SCHEMA)]
_Document = TypeVar("_Document", bound=BaseModel)


def parse_document(kind: type[_Document], body: bytes, *, strict: bool = False) -> _Document:
    """Return the document of a JSON body.

    Raises InvalidArgumentError if the body is not such a document.
    """
    try:
        return kind.model_validate_json(body, strict=strict)
    except ValidationError as error:
        raise InvalidArgumentError(validation_sentence(error.errors())) from None


class FitRequest(_Input):
    """A fit of a stored measurement."""

    measurement: Annotated[str, Field(pattern=SHA256, description="The measurement's sha256.")]
    options: _Options = {}


class AnglesRequest(_Input):
    """Points by half and difference angles."""

    theta_half_deg: list[Number]
    theta_diff_deg: list[Number]
    phi_diff_deg: Annotated[
        list[Number] | None, Field(description="90 where it is left out: both directions at one angle to the normal.")
    ] = None


class DirectionsRequest(_Input):
    """Points by pairs of unit vectors; the surface's normal is (0, 0, 1)."""

    omega_in: list[Vector]
    omega_out: list[Vector]


class Page(_Input):
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


class Waiting(_Input):
    """How long to wait for a fit."""

    wait: Annotated[
        float,
        Field(ge=0, allow_inf_nan=False, description="Answer when the fit has ended, or after this time [s]."),
        Plain,
    ] = 0.0


class Problem(BaseModel):
    """RFC 9457 problem document."""

    type: Annotated[str, Field(description="Stable name of the problem, for scripts.")]
    title: str
    status: int
    detail: Annotated[str, Field(description="One sentence: what is wrong and what would be right.")]
    instance: str


class FitFault(BaseModel):
    """Why a fit failed."""

    origin: Annotated[
        Literal["input", "compute", "system"],
        Field(
            description="`input`: the measurement or the options do not allow a fit. `compute`: the computation broke "
            "or met its time or memory limit. `system`: its process was lost. The same request runs again unless the "
            "origin is `input`."
        ),
    ]
    type: str
    message: str


class ComponentLobe(BaseModel):
    """The height of a component's own layers at some angles, one entry in each list for each angle."""

    theta_diff_deg: Annotated[list[float], Field(description="The angles.")]
    height: Annotated[list[Rgb], Field(description="Value at theta_half = 0 [1/sr].")]


_Range = Annotated[list[float], Field(min_length=2, max_length=2)]
_RgbRange = Annotated[list[_Range], Field(min_length=3, max_length=3)]


class ComponentRangesDocument(BaseModel):
    """Low and high end of a component's figures: each lies between them with a probability of 90 %."""

    light_share: _Range
    albedo: _RgbRange
    color: _RgbRange
    half_width_deg: _Range | None
    alpha: _Range | None
    f0: _RgbRange | None


class ComponentDocument(BaseModel):
    """One component of a fit that has light; the values of all components add up to the fit's.

    Its parameters are those of its brightest layer; a diffuse component has none.
    """

    label: _Label
    structure: Annotated[str, Field(description="The most probable structure of layers that has the component.")]
    light_share: Annotated[Share, Field(description="Share of all light that it reflects, at normal incidence.")]
    albedo: Annotated[Rgb, Field(description="Directional albedo at normal incidence.")]
    color: Annotated[Rgb, Field(description="The albedo over its largest channel.")]
    half_width_deg: Annotated[
        float | None, Field(description="theta_half at which slopes of facets are half as frequent as at 0.")
    ]
    alpha: Annotated[float | None, Field(description="Roughness: that of GGX or of Beckmann's distribution.")]
    kappa: Annotated[float | None, Field(description="Exponent of the tails: 2 is GGX, a smaller one falls slower.")]
    f0: Annotated[Rgb | None, Field(description="Reflectance of its facets at normal incidence.")]
    f90: Annotated[float | None, Field(description="The same at grazing incidence.")]
    lobe: ComponentLobe
    ranges: ComponentRangesDocument


class ComponentList(BaseModel):
    """The components of a fit that have light, from narrow to wide."""

    items: list[ComponentDocument]


class FitSummary(BaseModel):
    """A fit without its model."""

    id: Annotated[str, Field(pattern=FIT_ID)]
    name: Name
    status: Status
    progress: Share
    measurement: Annotated[str, Field(pattern=SHA256)]
    options: _Options
    metrics: Metrics | None
    error: FitFault | None
    created: datetime
    started: datetime | None
    finished: datetime | None
    algorithm: Annotated[str, Field(description="Version of the fit algorithm.")]
    library: Annotated[str, Field(description="Version of the library that accepted the fit.")]

    @computed_field(description="How alike lit spheres of measurement and fit look, in words and dB.")  # type: ignore[prop-decorator]
    @property
    def likeness(self) -> str | None:
        """What `metrics.psnr` says in words."""
        return None if self.metrics is None or self.metrics.psnr is None else likeness(self.metrics.psnr)


class FitDocument(FitSummary):
    """A fit: its state, and once it has succeeded its metrics, warnings, components and model."""

    warnings: Annotated[list[str], Field(description="What to know before the fit is used, one sentence each.")]
    components: Annotated[
        list[ComponentDocument] | None, Field(description="Those that have light, from narrow to wide.")
    ]
    model: Annotated[
        dict[str, Any] | None,
        Field(
            description="The model's own parameters as its file has them, which `export?format=json` gives: knots in "
            "radians, and control values, which are no values at angles; for those take `components`, or `/brdf`."
        ),
    ]


class Removal(_Input):
    """What a DELETE of a fit is to do."""

    only: Annotated[
        Literal["cancel", "delete"] | None,
        Field(description="`cancel` refuses a fit that has ended, `delete` one that has not; otherwise what applies."),
    ] = None


class RemovedFit(BaseModel):
    """What has become of a fit."""

    id: Annotated[str, Field(pattern=FIT_ID)]
    status: Annotated[
        Literal["cancelled", "deleted"],
        Field(description="`cancelled`: it was unfinished and stays in the list. `deleted`: it had ended and is gone."),
    ]


class FitList(BaseModel):
    """A page of fits, newest first."""

    items: list[FitSummary]


class MeasurementDocument(BaseModel):
    """A stored measurement."""

    sha256: Annotated[str, Field(pattern=SHA256, description="Its identity: the sha256 of the file's bytes.")]
    name: Name
    size: Annotated[int, Field(description="Length of the file [bytes].")]
    valid_nodes: Annotated[
        int, Field(description="Grid nodes with a value in all channels, above the horizon; 0 for samples.")
    ]
    created: datetime


class MeasurementDetails(MeasurementDocument):
    """A stored measurement with its fits."""

    fits: Annotated[list[str], Field(description="Ids of its fits, newest first, at most 200 of them.")]


class MeasurementList(BaseModel):
    """A page of measurements, newest first."""

    items: list[MeasurementDocument]


class Values(BaseModel):
    """BRDF values, one RGB triple for each point [1/sr]."""

    values: list[Rgb]


class MeasuredValues(BaseModel):
    """Values of a measurement, one RGB triple for each point [1/sr]; null where nothing was measured."""

    values: list[Rgb | None]


class Progress(BaseModel):
    """A server-sent event of a fit."""

    id: str
    status: Status
    progress: Share
    error: FitFault | None


class Health(BaseModel):
    """The state of the service."""

    status: Literal["live", "ready"]
    version: str


class Readiness(Health):
    """The state of a service that can take work."""


class Export(_Input):
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


class Picture(_Input):
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


class Figure(_Input):
    """How to draw a figure."""

    dark: Annotated[bool, Field(description="For a dark background.")] = False


class SomeSamples(_Input):
    """How many samples of a table."""

    most: Annotated[int, Field(ge=1, le=100_000, description="So many at most."), Plain] = 5000


class NewName(_Input):
    """Another name of a fit, or none."""

    name: Annotated[str | None, Field(max_length=MAX_LENGTH, description="null takes the name away.")]


def from_row(kind: type[_Document], row: FitRow | MeasurementRow, **more: Any) -> _Document:
    """Return a row's document; `more` is what the row does not have."""
    return kind.model_validate({**asdict(row), **more})
