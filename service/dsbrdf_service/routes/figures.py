"""Pictures of fits and of measurements."""

from collections.abc import Callable, Hashable
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from starlette.responses import Response

import dsbrdf
from dsbrdf.extras import require

from ..http import openapi
from ..http.responses import not_modified, tag_of
from ..jobs.steps import FIGURES, StoredMeasurement, difference_step, figure_step, sphere_step
from ..storage.schema import FitKey
from ..wire.fit_options import from_wire
from ..wire.schemas import Figure, FitSphere, Sphere
from .dependencies import NO_REPETITION, Context, Sha256, TheCaller, TheContext, TheFit

router = APIRouter(prefix="/v1", tags=["figures"], dependencies=NO_REPETITION)

_MEDIA_TYPES = {"png": "image/png", "svg": "image/svg+xml"}
PNG = _MEDIA_TYPES["png"]
_PICTURE = openapi.response("The picture.", {PNG: openapi.file(PNG)}) | openapi.NOT_MODIFIED
_FIGURE = openapi.response("The figure.", {kind: openapi.file(kind) for kind in _MEDIA_TYPES.values()})
_Figure = Annotated[
    str,
    Path(pattern=f"^({'|'.join(FIGURES)})$", description=f"One of {', '.join(FIGURES)}.", examples=["components"]),
]
_ImageFormat = Annotated[
    str, Path(pattern=f"^({'|'.join(_MEDIA_TYPES)})$", description="`png` or `svg`.", examples=["svg"])
]


@router.get(
    "/fits/{fit_id}/figures/sphere.png",
    response_class=Response,
    summary="A lit sphere of a fit",
    responses=_PICTURE | openapi.problems("not-found", "fit-not-finished", "invalid-argument"),
)
async def draw_sphere(
    request: Request,
    context: TheContext,
    fit: TheFit,
    wanted: Annotated[FitSphere, Query()],
) -> Response:
    """Return a picture of a sphere of the fit, or of one component, with the exposure of the fit or its measurement.

    The 99th percentile of that whole sphere becomes 1; what is brighter is clipped; then comes the sRGB curve.
    """
    loaded = await context.models.get(fit)
    part = loaded.model if wanted.component is None else loaded.part(wanted.component)
    exposed = loaded.model if wanted.exposure == "fit" else await _measurement_of(context, fit)
    step = sphere_step, exposed, part, wanted.lighting, wanted.size
    return await drawn_reply(request, context, PNG, ("sphere", fit, wanted.model_dump_json()), *step)


@router.get(
    "/fits/{fit_id}/figures/difference.png",
    response_class=Response,
    summary="How a sphere of a fit differs from its measurement's",
    responses=_PICTURE | openapi.problems("not-found", "measurement-damaged", "fit-not-finished", "invalid-argument"),
)
async def draw_difference(
    request: Request,
    context: TheContext,
    fit: TheFit,
    wanted: Annotated[Sphere, Query()],
) -> Response:
    """Return four times the difference of the pictures of fit and measurement, both with the measurement's exposure."""
    model, stored = (await context.models.get(fit)).model, await _measurement_of(context, fit)
    step = difference_step, model, stored, wanted.lighting, wanted.size
    return await drawn_reply(request, context, PNG, ("difference", fit, wanted.model_dump_json()), *step)


@router.get(
    "/fits/{fit_id}/figures/{figure}.{image_format}",
    response_class=Response,
    summary="A figure of a fit",
    responses=_FIGURE
    | openapi.NOT_MODIFIED
    | openapi.problems("not-found", "measurement-damaged", "fit-not-finished", "invalid-argument", "not-installed"),
)
async def draw_figure(
    request: Request,
    context: TheContext,
    fit: TheFit,
    figure: _Figure,
    image_format: _ImageFormat,
    wanted: Annotated[Figure, Query()],
) -> Response:
    """Return a figure of the fit and its measurement, which must still be stored.

    `profiles` measured and fitted values over theta_half; `components` the red channel's components with
    their own lobes; `lobes` its lobes in the model; `parameters` height, half width, tail and elongation of the
    components' own lobes over theta_diff; `residual` the relative difference over theta_half and theta_diff.
    """
    model = (await context.models.get(fit)).model
    row = await context.fit_row(fit)
    stored = await context.stored_measurement(fit.owner, row.measurement, row.name)
    require("plot", "matplotlib", purpose="figures")
    step = figure_step, figure, image_format, model, stored, from_wire(row.options).horizon_cutoff, wanted.dark
    key = "figure", fit, row.name, figure, image_format, wanted.dark
    return await drawn_reply(request, context, _MEDIA_TYPES[image_format], key, *step)


@router.get(
    "/measurements/{sha256}/figures/sphere.png",
    response_class=Response,
    summary="A lit sphere of a measurement",
    responses=_PICTURE | openapi.problems("not-found", "measurement-damaged", "invalid-argument"),
)
async def draw_measurement(
    request: Request,
    context: TheContext,
    caller: TheCaller,
    sha256: Sha256,
    wanted: Annotated[Sphere, Query()],
) -> Response:
    """Return a picture of a sphere of the measurement, which is interpolated, with an exposure of its own."""
    stored = await context.stored_measurement(caller.owner, sha256)
    step = sphere_step, stored, None, wanted.lighting, wanted.size
    return await drawn_reply(request, context, PNG, ("measured", caller.owner, sha256, wanted.model_dump_json()), *step)


async def _measurement_of(context: Context, fit: FitKey) -> StoredMeasurement:
    return await context.stored_measurement(fit.owner, (await context.fit_row(fit)).measurement)


async def drawn_reply(
    request: Request,
    context: Context,
    media_type: str,
    key: tuple[Hashable, ...],
    step: Callable[..., bytes],
    *arguments: Any,
) -> Response:
    """Return what `step` draws, unless the client has it; `key` determines it and names its owner."""
    headers = {"ETag": tag_of(repr((dsbrdf.__version__, *key)).encode())}
    if known := not_modified(request, headers):
        return known
    return Response(await context.in_process(request, key, step, *arguments), 200, headers, media_type)
