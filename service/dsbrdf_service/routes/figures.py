"""Pictures of fits and of measurements."""

import hashlib
from collections.abc import Callable, Hashable
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Path, Query, Request
from numpy.typing import NDArray
from starlette.responses import Response

import dsbrdf
from dsbrdf.extras import require

from ..access.authentication import CALLER_NAME
from ..errors import ProblemError
from ..http import openapi
from ..http.request_body import media_type_of
from ..http.responses import not_modified, tag_of
from ..jobs.steps import (
    FIGURES,
    StoredMeasurement,
    difference_step,
    figure_step,
    radiance_step,
    sphere_step,
    spheres_step,
    table_step,
    thumbnail_step,
)
from ..storage.schema import FitKey
from ..wire.fit_options import from_wire
from ..wire.points import NPY, panorama_from_npy
from ..wire.schemas import Figure, FitPicture, FitRadiance, FitSphere, Picture, Sphere
from .dependencies import NO_REPETITION, Context, Sha256, TheCaller, TheContext, TheFit

router = APIRouter(prefix="/v1", tags=["figures"], dependencies=NO_REPETITION)

_MEDIA_TYPES = {"png": "image/png", "svg": "image/svg+xml"}
PNG = _MEDIA_TYPES["png"]
_PICTURE = openapi.response("The picture.", {PNG: openapi.file(PNG)}) | openapi.NOT_MODIFIED
_FIGURE = openapi.response("The figure.", {kind: openapi.file(kind) for kind in _MEDIA_TYPES.values()})
_ARRAY = openapi.response("The array.", {NPY: openapi.file(NPY)})
_MAX_PANORAMA = 16_000_000  # bytes
_PANORAMA = openapi.body("float32 or float64 (rows, 2 rows, 3): linear RGB.", {NPY: openapi.file(NPY)})
_BODY_PROBLEMS = openapi.problems(
    "not-found", "measurement-damaged", "fit-not-finished", "invalid-argument", "too-large", *openapi.BODY_PROBLEMS
)
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
    "/fits/{fit_id}/figures/spheres.png",
    response_class=Response,
    summary="Spheres of a fit side by side",
    responses=_PICTURE | openapi.problems("not-found", "measurement-damaged", "fit-not-finished", "invalid-argument"),
)
async def draw_spheres(
    request: Request, context: TheContext, fit: TheFit, wanted: Annotated[Picture, Query()]
) -> Response:
    """Return one picture of spheres under three lights: measured, fit, their difference times 4, then each component.

    All have the exposure of the measurement; where none is stored on a grid, the first is the fit, with its own.
    """
    loaded, stored = await context.models.get(fit), await _measurement_if_any(context, fit)
    key = "spheres", fit, stored and stored.sha256, wanted.size
    step = spheres_step, loaded.model, list(loaded.decomposition), stored, wanted.size
    return await drawn_reply(request, context, PNG, key, *step)


@router.get(
    "/fits/{fit_id}/figures/thumbnail.png",
    response_class=Response,
    summary="A small picture of a fit",
    responses=_PICTURE | openapi.problems("not-found", "measurement-damaged", "fit-not-finished", "invalid-argument"),
)
async def draw_thumbnail(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return a small sphere in the environment: the fit, and on the left its measurement if it is stored on a grid."""
    model, stored = (await context.models.get(fit)).model, await _measurement_if_any(context, fit)
    key = "thumbnail", fit, stored and stored.sha256
    return await drawn_reply(request, context, PNG, key, thumbnail_step, model, stored)


@router.get(
    "/fits/{fit_id}/figures/sphere.npy",
    response_class=Response,
    summary="Radiance of a lit sphere of a fit",
    responses=_ARRAY | openapi.NOT_MODIFIED | openapi.problems("not-found", "fit-not-finished", "invalid-argument"),
)
async def light_fit(
    request: Request, context: TheContext, fit: TheFit, wanted: Annotated[FitRadiance, Query()]
) -> Response:
    """Return the linear RGB radiance of a sphere of the fit or a component: float32 (size, size, 3), from the top."""
    part = (await context.models.get(fit)).part(wanted.component)
    key = "radiance", fit, wanted.model_dump_json()
    return await drawn_reply(request, context, NPY, key, radiance_step, part, wanted.lighting, wanted.size)


@router.post(
    "/fits/{fit_id}/figures/sphere.npy",
    response_class=Response,
    summary="Radiance of a sphere of a fit in a panorama",
    responses=_ARRAY | _BODY_PROBLEMS,
    openapi_extra=_PANORAMA,
)
async def light_fit_by_panorama(
    request: Request, context: TheContext, fit: TheFit, wanted: Annotated[FitPicture, Query()]
) -> Response:
    """Return the same in the light of a panorama: the first row is straight up, the middle column behind the sphere."""
    part = (await context.models.get(fit)).part(wanted.component)
    pixels, digest = await _panorama(request, context)
    key = "panorama", fit, wanted.model_dump_json(), digest
    return await drawn_reply(request, context, NPY, key, radiance_step, part, pixels, wanted.size)


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


@router.get(
    "/measurements/{sha256}/figures/sphere.npy",
    response_class=Response,
    summary="Radiance of a lit sphere of a measurement",
    responses=_ARRAY | openapi.NOT_MODIFIED | openapi.problems("not-found", "measurement-damaged", "invalid-argument"),
)
async def light_measurement(
    request: Request, context: TheContext, caller: TheCaller, sha256: Sha256, wanted: Annotated[Sphere, Query()]
) -> Response:
    """Return the linear RGB radiance of a sphere of the measurement: float32 (size, size, 3), top row first."""
    stored = await context.stored_measurement(caller.owner, sha256)
    key = "radiance", caller.owner, sha256, wanted.model_dump_json()
    return await drawn_reply(request, context, NPY, key, radiance_step, stored, wanted.lighting, wanted.size)


@router.post(
    "/measurements/{sha256}/figures/sphere.npy",
    response_class=Response,
    summary="Radiance of a sphere of a measurement in a panorama",
    responses=_ARRAY | _BODY_PROBLEMS,
    openapi_extra=_PANORAMA,
)
async def light_measurement_by_panorama(
    request: Request, context: TheContext, caller: TheCaller, sha256: Sha256, wanted: Annotated[Picture, Query()]
) -> Response:
    """Return the same in the light of a panorama: the first row is straight up, the middle column behind the sphere."""
    stored = await context.stored_measurement(caller.owner, sha256)
    pixels, digest = await _panorama(request, context)
    key = "panorama", caller.owner, sha256, wanted.size, digest
    return await drawn_reply(request, context, NPY, key, radiance_step, stored, pixels, wanted.size)


@router.get(
    "/measurements/{sha256}/table.npy",
    response_class=Response,
    summary="A measurement at all nodes, without gaps",
    responses=_ARRAY | openapi.NOT_MODIFIED | openapi.problems("not-found", "measurement-damaged", "invalid-argument"),
)
async def get_table(request: Request, context: TheContext, caller: TheCaller, sha256: Sha256) -> Response:
    """Return ln(value + 1e-6) at the nodes of the MERL grid: float16 (theta_half, theta_diff, phi_diff, RGB), 8.7 MB.

    Linear interpolation of it is the measurement as the spheres show it; a texture of a graphics card can hold it.
    """
    stored = await context.stored_measurement(caller.owner, sha256)
    return await drawn_reply(request, context, NPY, ("table", caller.owner, sha256), table_step, stored)


async def _panorama(request: Request, context: Context) -> tuple[NDArray[np.float32], bytes]:
    """Return the panorama in the body, and its digest."""
    media_type_of(request, NPY)
    async with context.bodies.received(request, _MAX_PANORAMA, request.scope[CALLER_NAME]) as body:
        pixels = panorama_from_npy(body).astype(np.float32)
        return pixels, hashlib.sha256(body).digest()


async def _measurement_if_any(context: Context, fit: FitKey) -> StoredMeasurement | None:
    """Return the measurement of a fit, unless it is not stored any more or is a table of samples."""
    try:
        return await _measurement_of(context, fit)
    except ProblemError as error:
        if error.kind != "not-found":
            raise
        return None


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
