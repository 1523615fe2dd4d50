"""The JSON documents as pydantic models, made from rows of the store and from models.

Angles in degrees (``_deg``), BRDF values in 1/sr, RGB order.
"""

from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, WithJsonSchema, model_validator
from pydantic_core import PydanticCustomError

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.decomposition import LABELS
from dsbrdf.model.render import LIGHTINGS
from dsbrdf.output.export import FORMATS
from service.errors import validation_sentence
from service.storage.schema import FitRow, MeasurementRow, Status
from service.wire.fit_options import OPTIONS_SCHEMA
from service.wire.values import check_plain

FIT_ID = r"^[0-9a-f]{32}$"
SHA256 = r"^[0-9a-f]{64}$"

Share = Annotated[float, Field(ge=0, le=1)]
Plain = BeforeValidator(check_plain)
"""Of numbers in a query or a path: those that only Python reads are none."""
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

    limit: Annotated[int, Plain, Field(ge=1, le=200, description="Items in the answer.")] = 50
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
        Plain,
        Field(ge=0, allow_inf_nan=False, description="Answer when the fit has ended, or after this time [s]."),
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


class Lobes(BaseModel):
    """Parameters of K lobes; control values of splines over theta_diff, or values at the knots where it is linear."""

    theta_diff_deg: Annotated[list[float], Field(description="Knots of amplitude and delta.")]
    amplitude: Annotated[
        list[list[list[float]]], Field(description="Height [1/sr] in red, green, blue, shape (3, D, K).")
    ]
    shape_theta_diff_deg: Annotated[list[float], Field(description="Knots of kappa, gamma and center.")]
    kappa: Annotated[
        list[list[list[float]]], Field(description="Scale, shape (C, S, K); C is 1 for all channels, or 3 for each.")
    ]
    gamma: Annotated[list[list[list[float]]], Field(description="Shape, shape (C, S, K).")]
    center_deg: Annotated[list[list[list[float]]], Field(description="Ring angle, shape (C, S, K).")]
    elongation_theta_diff_deg: Annotated[list[float], Field(description="Knots of elongation.")]
    elongation: Annotated[list[list[float]], Field(description="Stretch, 0 for a round lobe, shape (E, K).")]
    delta: Annotated[list[list[float]], Field(description="Height where theta_half < 1 degree [1/sr], shape (3, B).")]
    interpolation: Annotated[str, Field(description="`spline` or `linear`.")]
    lobe: Annotated[str, Field(description="Family of the lobes, `hemi_epd` or `student`.")]


class FitSummary(BaseModel):
    """A fit without its lobes."""

    id: Annotated[str, Field(pattern=FIT_ID)]
    name: Name
    status: Status
    progress: Share
    measurement: Annotated[str, Field(pattern=SHA256)]
    options: _Options
    metrics: dict[str, float | None] | None
    error: FitFault | None
    created: datetime
    started: datetime | None
    finished: datetime | None
    algorithm: Annotated[str, Field(description="Version of the fit algorithm.")]
    library: Annotated[str, Field(description="Version of the library that accepted the fit.")]


class FitDocument(FitSummary):
    """A fit: its state, and once it has succeeded its metrics, warnings and lobes."""

    warnings: Annotated[list[str], Field(description="What to know before the fit is used, one sentence each.")]
    lobes: Lobes | None


class FitList(BaseModel):
    """A page of fits, newest first."""

    items: list[FitSummary]


class MeasurementDocument(BaseModel):
    """A stored measurement."""

    sha256: Annotated[str, Field(pattern=SHA256, description="Its identity: the sha256 of the file's bytes.")]
    name: Name
    size: Annotated[int, Field(description="Length of the file [bytes].")]
    valid_nodes: Annotated[int, Field(description="Grid nodes with a value in all channels, above the horizon.")]
    created: datetime


class MeasurementList(BaseModel):
    """A page of measurements, newest first."""

    items: list[MeasurementDocument]


class Values(BaseModel):
    """BRDF values, one RGB triple for each point [1/sr]."""

    values: list[Rgb]


class ComponentDocument(BaseModel):
    """One component of a fit; the three components' values add up to the fit's."""

    label: _Label
    lobes: Annotated[list[int], Field(description="Indices of its lobes in the fit.")]
    parameters: Lobes
    albedo: Annotated[Rgb, Field(description="Directional albedo at normal incidence.")]
    half_width_deg: Annotated[float | None, Field(description="Half width at half maximum; null without lobes.")]
    margin: Annotated[float | None, Field(description="How clear the label is; null without lobes.")]


class ComponentList(BaseModel):
    """The components of a fit, from narrow to wide."""

    items: list[ComponentDocument]


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


class Export(_Input):
    """What to export."""

    format: Annotated[
        Literal[*FORMATS],  # type: ignore[valid-type]
        Field(description="Format of the file; `materialx` takes some seconds."),
    ]
    component: _Component = None


class Sphere(_Input):
    """What to draw."""

    lighting: Annotated[
        Literal[*LIGHTINGS],  # type: ignore[valid-type]
        Field(description="Three lights, or a sky with sun and window."),
    ] = "three_lights"
    size: Annotated[int, Plain, Field(ge=8, le=256, description="Pixels along a side.")] = 128


class FitSphere(Sphere):
    """What of a fit to draw."""

    component: _Component = None


def from_row(kind: type[_Document], row: FitRow | MeasurementRow, **more: Any) -> _Document:
    """Return a row's document; `more` is what the row does not have."""
    return kind.model_validate({**asdict(row), **more})
