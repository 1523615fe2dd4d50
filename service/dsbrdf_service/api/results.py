"""Return the result of a fit: its components, and files of the model, a component or the layers for other programs."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from pydantic import Field
from pydantic_core import from_json, to_json
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from dsbrdf.components.shares import ComponentRanges, RgbRange
from dsbrdf.components.surfaces import Misfit
from dsbrdf.data.merl_validation import FILE_SIZE
from dsbrdf.output.export import (
    EXAMPLES,
    FORMATS,
    LAYERS,
    PARTS,
    check_holds_component,
    check_shader_options,
    example,
    export_model,
)
from dsbrdf.output.export.glsl import NAME

from ..compute.steps import export_step
from ..http import openapi
from ..http.messages import BINARY, JSON, OpenFileResponse, content_disposition, tagged_reply
from .context import CHECKED_QUERY, TheContext, TheFit, TheRow
from .fields import Document, Input, Label, Range, Rgb, Share


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


router = APIRouter(prefix="/v1/fits/{fit_id}", dependencies=CHECKED_QUERY)
_PROBLEMS = openapi.problems("not-found", "fit-not-finished")


@router.get("/components", tags=["components"], response_model=ComponentList, responses=openapi.TAGGED | _PROBLEMS)
async def get_components(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return the components that reflect light: specular spike, specular lobe, diffuse, or some of them.

    Each component has its values at some angles, albedo, colour, half width, layers, surfaces, and ranges.
    """
    result = from_json(await run_in_threadpool(context.store.result, fit))
    return tagged_reply(request, to_json({"items": result["components"]}))


class Export(Input):
    """Query parameters of an export."""

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
        str | None, Field(description="Name of the function in `glsl`; all other names in the file begin with it.")
    ] = None
    sampling: Annotated[bool, Field(description="Add functions to `glsl` that draw directions.")] = False
    example: Annotated[
        bool,
        Field(
            description="Instead of the file, an example that shows it on a sphere and is saved beside it: for "
            f"{', '.join(f'`{name}`' for name in EXAMPLES)}."
        ),
    ] = False


_MEDIA_TYPES = (BINARY, *(kind.media_type.partition(";")[0] for kind in FORMATS.values()))
# Binary comes first, because a generated client reads every answer as the first media type that it knows.
_EXPORTED = {name: openapi.file(name) for name in _MEDIA_TYPES} | {JSON: {"schema": {"type": "object"}}}


@router.get(
    "/export",
    tags=["export"],
    response_class=Response,
    responses={200: {"description": "The file; `Content-Disposition` names it.", "content": _EXPORTED}, **_PROBLEMS},
)
async def export_fit(
    request: Request, context: TheContext, row: TheRow, wanted: Annotated[Export, Query()]
) -> Response:
    """Return the model, one component, or the layers of all components, for another program."""
    loaded = await context.models.get(row.key)
    check_shader_options(wanted.format, wanted.name, sampling=wanted.sampling)
    if wanted.component not in (None, LAYERS):
        check_holds_component(wanted.format)
    suffix = FORMATS[wanted.format].suffix
    is_first = wanted.format == next(name for name, kind in FORMATS.items() if kind.suffix == suffix)
    kind = None if is_first else wanted.format.removeprefix(f"{suffix}-")  # Files of one fit have different names.
    name = "-".join(part for part in (row.name or row.id, wanted.component, kind) if part)
    file = f"{name}.{suffix}"
    headers = {"Content-Disposition": content_disposition(file), "Content-Type": FORMATS[wanted.format].media_type}
    model = loaded.decomposition.layers if wanted.component == LAYERS else loaded.part(wanted.component)
    duration = FORMATS[wanted.format].time
    if wanted.example and wanted.format != "glsl":  # Other examples only name the exported file, so no export is made.
        return _example(Path(file), wanted, b"")
    if duration != "short":
        arguments = model, wanted.format, name
        made = await context.in_process(request, export_step, *arguments, max_bytes=FILE_SIZE, duration=duration)
        return OpenFileResponse(made, headers)
    report = loaded.report if wanted.component is None else None
    export = partial(export_model, model, wanted.format, report, name=wanted.name, sampling=wanted.sampling)
    content = await context.computations.run(request, export)
    return _example(Path(file), wanted, content) if wanted.example else Response(content, 200, headers)


def _example(file: Path, wanted: Export, content: bytes) -> Response:
    beside, text = example(file, wanted.format, content, wanted.name or NAME)
    return Response(text, headers={"Content-Disposition": content_disposition(beside.name)}, media_type="text/plain")
