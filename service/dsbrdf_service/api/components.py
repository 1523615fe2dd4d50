"""Return the components of a fit, with their layers, surfaces and ranges."""

from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import Field
from pydantic_core import from_json, to_json
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from dsbrdf.components.misfit import Misfit
from dsbrdf.components.ranges import ComponentRanges, RgbRange

from ..http import openapi
from ..http.responses import tagged_reply
from .context import CHECKED_QUERY, TheContext, TheFit
from .fields import Document, Label, Range, Rgb, Share


class ComponentLobe(Document):
    """Values of a component's layers at theta_half = 0, one entry in each list for each angle theta_diff."""

    theta_diff_deg: Annotated[list[float], Field(description="The angles.")]
    height: Annotated[list[Rgb], Field(description="Value at theta_half = 0 [1/sr].")]


class SurfaceDocument(Document):
    """One rough surface of a component; a parameter is null if it does not describe the component well."""

    alpha: Annotated[float | None, Field(description="Roughness, as in the GGX and Beckmann distributions.")]
    tail_exponent: float | None
    """Exponent of the tails: 2 is GGX, a smaller number has longer tails."""
    f0: Annotated[Rgb | None, Field(description="Reflectance of its facets at normal incidence.")]
    f70: Annotated[Rgb | None, Field(description="Reflectance of its facets at 70 degrees of incidence.")]
    alpha_range: Annotated[Range | None, Field(description="Interval that contains alpha with a probability of 90 %.")]
    f0_range: Annotated[RgbRange | None, Field(description="Interval that contains F0 with a probability of 90 %.")]
    f70_range: Annotated[RgbRange | None, Field(description="Interval that contains F70 with a probability of 90 %.")]


class ComponentDocument(Document):
    """One component of a fit that reflects light; the values of all components add up to the values of the fit.

    The surfaces describe the component and are sorted, the brightest first; a diffuse component has no surfaces.
    """

    label: Label
    structure: str
    """The most probable list of layers that contains the component, such as `dielectric over diffuse`."""
    light_share: Share
    """Fraction of the reflected light that belongs to the component, at normal incidence."""
    albedo: Rgb
    """Directional albedo at normal incidence."""
    color: Rgb
    """The albedo divided by its largest channel."""
    half_width_deg: float | None
    """theta_half at which the facets of its surfaces are half as frequent as at theta_half = 0."""
    layers: list[dict[str, Any]]
    """Layers fitted to the values of the component, in the form of the export of layers."""
    surfaces: Annotated[list[SurfaceDocument], Field(max_length=2)]
    """Its rough surfaces, at most two."""
    misfit: Misfit
    remarks: list[str]
    """Sentences about parameters that are null, because they do not describe the component."""
    lobe: ComponentLobe
    ranges: ComponentRanges
    """Intervals that contain light, albedo and colour with a probability of 90 %."""


class ComponentList(Document):
    """The components of a fit that reflect light, from narrow to wide."""

    items: list[ComponentDocument]


router = APIRouter(prefix="/v1/fits/{fit_id}/components", tags=["components"], dependencies=CHECKED_QUERY)


@router.get(
    "", response_model=ComponentList, responses=openapi.TAGGED | openapi.problems("not-found", "fit-not-finished")
)
async def get_components(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return the components that reflect light: specular spike, specular lobe, diffuse, or some of them.

    Each component has its values at some angles, albedo, colour, half width, layers, surfaces, and ranges.
    """
    result = from_json(await run_in_threadpool(context.store.result, fit))
    return tagged_reply(request, to_json({"items": result["components"]}))
