"""Draw pictures of fits and of measurements."""

import hashlib
from collections.abc import Callable, Hashable
from functools import partial
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from fastapi import APIRouter, Depends, Path, Query, Request
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

import dsbrdf
from dsbrdf.extras import require
from dsbrdf.rendering.sphere import LIGHTINGS

from ..compute.steps import figure_step, samples_step, sphere_step, table_step
from ..http import openapi
from ..http.messages import NPY, OpenFileResponse, long_reply, media_type_of, not_modified, tag_of, tagged_reply
from ..wire import from_wire
from .context import CHECKED_QUERY, Sha256, TheCaller, TheContext, TheLoadedFit, TheMeasurement, TheRow
from .fields import PLAIN, Label
from .points import panorama_from_npy

_Route = TypeVar("_Route", bound=Callable[..., Any])

router = APIRouter(prefix="/v1", tags=["figures"], dependencies=CHECKED_QUERY)

_MEDIA_TYPES = {"png": "image/png", "svg": "image/svg+xml", "npy": NPY}
_MAX_PANORAMA_BYTES = 16_000_000
_MAX_TABLE_BYTES = 9_000_000
_Size = Annotated[int, Query(ge=8, le=256, description="Pixels along a side."), PLAIN]
_Lighting = Annotated[
    Literal[*LIGHTINGS],  # type: ignore[valid-type]
    Query(description="Three lights, or a sky with sun and window."),
]
_Component = Annotated[Label | None, Query(description="One component instead of the whole fit.")]
_MaxSamples = Annotated[int, Query(ge=1, le=100_000, description="Maximum number of samples."), PLAIN]
_Figure = Annotated[Literal["parameters", "residual"], Path(examples=["parameters"])]
_SphereFormat = Annotated[Literal["png", "npy"], Path(description="`png` or `npy`.", examples=["png"])]


def _draws(
    path: str, *problems: str, formats: tuple[str, ...] = ("png",), **declared: Any
) -> Callable[[_Route], _Route]:
    """Return the decorator of a route that answers with a picture or its data, in one of the formats."""
    kinds, method = ("not-found", "measurement-damaged", *problems), "GET"
    if "requestBody" in declared:
        kinds, method = (*kinds, "too-large", *openapi.BODY_PROBLEMS), "POST"
    content = {_MEDIA_TYPES[name]: openapi.file(_MEDIA_TYPES[name]) for name in formats}
    responses = openapi.TAGGED | openapi.problems(*kinds)
    responses[200] = {"description": "The picture, or its data.", "content": content, **openapi.headers("ETag")}
    about: dict[str, Any] = {"response_class": Response, "responses": responses, "openapi_extra": declared}
    return router.api_route(path, methods=[method], **about)


_draws_npy = partial(_draws, formats=("npy",))
_draws_sphere = partial(_draws, formats=("png", "npy"))
_PANORAMA = openapi.body("float32 or float64 (rows, 2 rows, 3): linear RGB.", {NPY: openapi.file(NPY)})


class _Drawing:
    """Answer a request with the picture that a step draws, or with 304 if the client has this picture."""

    def __init__(self, request: Request, context: TheContext, caller: TheCaller) -> None:
        self._request, self._context, self._caller = request, context, caller

    async def __call__(
        self, step: Callable[..., Any], *arguments: Any, of: Hashable = None, max_bytes: int = 0
    ) -> Response:
        """Return the result of a `step`, whose ETag is a hash of the request's address, the caller and `of`.

        With `max_bytes`, the step writes a file of at most this length.
        """
        path = self._request.scope["path"]
        drawn_from = dsbrdf.__version__, self._caller.owner, path, self._request.url.query, of
        headers = {"ETag": tag_of(repr(drawn_from).encode())}
        if known := not_modified(self._request, headers):
            return known
        headers["Content-Type"] = _MEDIA_TYPES[path.rpartition(".")[2]]
        drawn = await self._context.in_process(self._request, step, *arguments, max_bytes=max_bytes)
        if max_bytes:
            return OpenFileResponse(drawn, headers)
        return await long_reply(self._context.store.writing, self._caller, drawn, headers)


Draw = Annotated[_Drawing, Depends()]


async def _panorama_in(request: Request, context: TheContext) -> tuple[NDArray[np.float32], bytes]:
    media_type_of(request, NPY)
    async with context.bodies.received(request, _MAX_PANORAMA_BYTES) as body:
        return panorama_from_npy(body).astype(np.float32), hashlib.sha256(body).digest()


_Panorama = Annotated[tuple[NDArray[np.float32], bytes], Depends(_panorama_in)]


@_draws_sphere("/fits/{fit_id}/figures/sphere.{file_format}", "fit-not-finished")
async def draw_sphere(
    draw: Draw,
    fit: TheLoadedFit,
    file_format: _SphereFormat,
    size: _Size = 128,
    lighting: _Lighting = LIGHTINGS[0],
    component: _Component = None,
) -> Response:
    """Return a lit sphere of the fit, or of one component: a picture, or its linear RGB radiance.

    The radiance is float32 (size, size, 3), with rows from the top. The picture has the exposure of the whole fit,
    which scales the 99th percentile of the fit's sphere to 1; larger values are clipped, and the sRGB curve is applied.
    """
    return await draw(sphere_step, file_format, fit.model, fit.part(component), lighting, size)


@_draws("/fits/{fit_id}/figures/thumbnail.png", "fit-not-finished")
async def get_thumbnail(request: Request, context: TheContext, row: TheRow) -> Response:
    """Return a small sphere under three lights: the fit, and on the left its measurement if that is on a grid.

    The thumbnail is drawn when the fit ends, and is stored as long as the fit.
    """
    kept = await run_in_threadpool(context.store.thumbnail, row.key)
    return tagged_reply(request, kept, _MEDIA_TYPES["png"])


@_draws_sphere("/fits/{fit_id}/figures/sphere.{file_format}", "fit-not-finished", **_PANORAMA)
async def draw_sphere_in_panorama(
    draw: Draw,
    fit: TheLoadedFit,
    file_format: _SphereFormat,
    panorama: _Panorama,
    size: _Size = 128,
    component: _Component = None,
) -> Response:
    """Return a sphere of the fit under a panorama: first row straight up, middle column behind the sphere."""
    pixels, digest = panorama
    return await draw(sphere_step, file_format, fit.model, fit.part(component), pixels, size, of=digest)


@_draws("/fits/{fit_id}/figures/{figure}.svg", "fit-not-finished", "not-installed", formats=("svg",))
async def draw_figure(
    draw: Draw,
    context: TheContext,
    fit: TheLoadedFit,
    row: TheRow,
    figure: _Figure,
    dark: Annotated[bool, Query(description="For a dark background, which is seen through it.")] = False,
) -> Response:
    """Return a figure of the fit and its measurement, which must still be stored.

    `parameters` shows the components' values at theta_half = 0 and directional albedos; `residual` shows the relative
    difference over theta_half and theta_diff, for a table of samples at the samples.
    """
    stored = await context.stored_measurement(row.owner, row.measurement, row.name, on_grid=None)
    require("plot", "matplotlib", purpose="figures")
    return await draw(figure_step, figure, fit.model, stored, from_wire(row.options), dark, of=row.name)


@_draws_sphere("/measurements/{sha256}/figures/sphere.{file_format}")
async def draw_measurement(
    draw: Draw,
    stored: TheMeasurement,
    file_format: _SphereFormat,
    size: _Size = 128,
    lighting: _Lighting = LIGHTINGS[0],
) -> Response:
    """Return a lit sphere of the interpolated measurement, as for a fit; the picture has the measurement's exposure."""
    return await draw(sphere_step, file_format, stored, stored, lighting, size)


@_draws_sphere("/measurements/{sha256}/figures/sphere.{file_format}", **_PANORAMA)
async def draw_measurement_in_panorama(
    draw: Draw, stored: TheMeasurement, file_format: _SphereFormat, panorama: _Panorama, size: _Size = 128
) -> Response:
    """Return a sphere of a measurement under a panorama, which is placed as for a fit."""
    pixels, digest = panorama
    return await draw(sphere_step, file_format, stored, stored, pixels, size, of=digest)


@_draws_npy("/measurements/{sha256}/table.npy")
async def get_table(draw: Draw, stored: TheMeasurement) -> Response:
    """Return ln(value + 1e-6) at the nodes of the MERL grid: float16 (theta_half, theta_diff, phi_diff, RGB), 8.7 MB.

    A shader can interpolate this table linearly, as a texture, to show the measurement as the drawn spheres do.
    """
    return await draw(table_step, stored, max_bytes=_MAX_TABLE_BYTES)


@_draws_npy("/measurements/{sha256}/samples.npy")
async def get_samples(
    draw: Draw, context: TheContext, caller: TheCaller, sha256: Sha256, max_samples: _MaxSamples = 5000
) -> Response:
    """Return omega_in, omega_out and RGB values of at most `max_samples` random samples of a table, float32 (n, 9)."""
    stored = await context.stored_measurement(caller.owner, sha256, on_grid=False)
    return await draw(samples_step, stored, max_samples)
