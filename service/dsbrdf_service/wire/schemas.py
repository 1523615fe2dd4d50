"""The JSON documents that the service answers with, as pydantic models made from rows of the store and from models.

Angles in degrees (``_deg``), BRDF values in 1/sr, RGB order.
"""

from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, Field, computed_field

from dsbrdf.engines.engine import Fault
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.output.report_text import likeness
from dsbrdf.output.table_summary import ANGLE_NAMES

from ..storage.schema import FitRow, MeasurementRow, Status
from .inputs import FIT_ID, SHA256, Label, Options

_Document = TypeVar("_Document", bound=BaseModel)
Share = Annotated[float, Field(ge=0, le=1)]
Rgb = Annotated[list[float], Field(min_length=3, max_length=3)]
Name = Annotated[str | None, Field(description="The latest name given; no part of the identity.")]


class Problem(BaseModel):
    """RFC 9457 problem document."""

    type: Annotated[str, Field(description="Stable name of the problem, for scripts.")]
    title: str
    status: int
    detail: Annotated[str, Field(description="One sentence: what is wrong and what would be right.")]
    instance: str


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

    label: Label
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
    options: Options
    metrics: Metrics | None
    error: Annotated[Fault | None, Field(description="The same request runs again unless `origin` is `input`.")]
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


class ColumnDocument(BaseModel):
    """A column of a table."""

    name: str
    read_as: Annotated[str | None, Field(description="What it means; null if it is not read.")]
    unit: Annotated[str, Field(description="As the table says it, empty if it does not.")]


class TableDocument(BaseModel):
    """What is understood of a table of samples."""

    n_rows: int
    n_samples: Annotated[int, Field(description="Rows that can be fitted.")]
    columns: list[ColumnDocument]
    ranges: Annotated[
        dict[str, _Range],
        Field(description=f"Smallest and largest of {', '.join(ANGLE_NAMES)} [degrees], red, green and blue [1/sr]."),
    ]
    angles_of_incidence: Annotated[list[float] | None, Field(description="theta_in [degrees], if they are few.")]
    in_plane_of_incidence: Annotated[Share, Field(description="Share of the samples.")]
    warnings: list[str]
    first: Annotated[list[list[float]], Field(description="The first samples, with numbers as those of `ranges`.")]


class Values(BaseModel):
    """BRDF values, one RGB triple for each point [1/sr]."""

    values: list[Rgb]


class MeasuredValues(BaseModel):
    """Values of a measurement, one RGB triple for each point [1/sr]; null where nothing was measured."""

    values: list[Rgb | None]


class Health(BaseModel):
    """The state of the service."""

    status: Literal["live", "ready"]
    version: str


def from_row(kind: type[_Document], row: FitRow | MeasurementRow, **more: Any) -> _Document:
    """Return a row's document; `more` is what the row does not have."""
    return kind.model_validate({**asdict(row), **more})
