"""Pictures of fits and of measurements."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Path, Query, Request
from starlette.responses import Response

import dsbrdf
from dsbrdf import DSBRDF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import map_merl
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.extras import require
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.model.render import render_sphere, sphere_normals
from dsbrdf.output.figures import encode_figure, lobes_figure, profiles_figure
from dsbrdf.output.parameters_figure import parameters_figure
from dsbrdf.output.png import encode_png
from dsbrdf.output.residual_figure import residual_figure
from service.http import openapi
from service.http.responses import is_current, tag_of
from service.routes.dependencies import NO_QUERY, NO_REPETITION, Context, Sha256, TheCaller, TheContext, TheFit
from service.storage.schema import FitRow
from service.storage.store import Store
from service.wire.fit_options import from_wire
from service.wire.schemas import FitSphere, Sphere

if TYPE_CHECKING:
    from matplotlib.figure import Figure

router = APIRouter(prefix="/v1", tags=["figures"], dependencies=NO_REPETITION)

_FIGURES: dict[str, Callable[[Profiles, DSBRDF], "Figure"]] = {
    "profiles": profiles_figure,
    "components": lobes_figure,
    "lobes": partial(lobes_figure, model_lobes=True),
    "parameters": lambda reduced, model: parameters_figure(model, title=reduced.name),
    "residual": residual_figure,
}
_MEDIA_TYPES = {"png": "image/png", "svg": "image/svg+xml"}
_PNG = _MEDIA_TYPES["png"]
_PICTURE = openapi.response("The picture.", {_PNG: openapi.file(_PNG)}) | openapi.NOT_MODIFIED
_FIGURE = openapi.response("The figure.", {kind: openapi.file(kind) for kind in _MEDIA_TYPES.values()})
_Figure = Annotated[
    str,
    Path(pattern=f"^({'|'.join(_FIGURES)})$", description=f"One of {', '.join(_FIGURES)}.", examples=["components"]),
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
    """Return a picture of a sphere of the fit, or of one component, with the exposure of the whole fit.

    The 99th percentile of the whole fit's sphere becomes 1; what is brighter is clipped; then comes the sRGB curve.
    """
    etag = tag_of(dsbrdf.__version__, fit.id, wanted)
    run = context.computations.for_request(request, {"ETag": etag, "Content-Type": _PNG}, "medium")
    whole = await context.models.component(fit, None, run)
    part = await context.models.component(fit, wanted.component, run)
    return await _drawn(request, context, fit.owner, etag, _PNG, lambda: _sphere(whole, part, wanted))


@router.get(
    "/fits/{fit_id}/figures/{figure}.{image_format}",
    dependencies=NO_QUERY,
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
) -> Response:
    """Return a figure of the fit and its measurement, which must still be stored.

    `profiles` measured and fitted values over theta_half; `components` the red channel's components with
    their own lobes; `lobes` its lobes in the model; `parameters` height, half width, tail and elongation of the
    components' own lobes over theta_diff; `residual` the relative difference over theta_half and theta_diff.
    """
    model = (await context.models.get(fit)).model
    row = await context.fit_row(fit)
    await context.measurement_row(fit.owner, row.measurement)
    etag, media_type = tag_of(dsbrdf.__version__, fit.id, row.name, figure, image_format), _MEDIA_TYPES[image_format]

    def draw() -> bytes:
        return _figure(context.store, row, model, figure, image_format)

    return await _drawn(request, context, fit.owner, etag, media_type, draw)


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
    await context.measurement_row(caller.owner, sha256)
    etag = tag_of(dsbrdf.__version__, sha256, wanted)

    def draw() -> bytes:
        measurement = _measurement(context.store, caller.owner, sha256)
        return _sphere(measurement, measurement, wanted)

    return await _drawn(request, context, caller.owner, etag, _PNG, draw)


async def _drawn(
    request: Request,
    context: Context,
    owner: str,
    etag: str,
    media_type: str,
    draw: Callable[[], bytes],
) -> Response:
    """Return a picture, which is drawn unless the client has it."""
    if is_current(request, etag):
        return Response(None, 304, {"ETag": etag})
    headers = {"ETag": etag, "Content-Type": media_type}
    content = await context.computations.run(request, ("figure", owner, etag), draw, headers, "medium")
    return Response(content, 200, headers)


def _sphere(whole: ReflectanceModel | Measurement, part: ReflectanceModel | Measurement, wanted: Sphere) -> bytes:
    image = render_sphere(whole, lighting=wanted.lighting, size=wanted.size)
    factor = exposure(image, sphere_normals(wanted.size)[1])
    if part is not whole:
        image = render_sphere(part, lighting=wanted.lighting, size=wanted.size)
    return encode_png(displayed(image, factor))


def _figure(store: Store, row: FitRow, model: DSBRDF, figure: str, image_format: str) -> bytes:
    require("plot", "matplotlib", purpose="figures")
    import matplotlib as mpl

    mpl.rcParams["svg.hashsalt"] = "dsbrdf"  # the same figure has the same bytes, as its ETag says
    options = from_wire(row.options)
    reduced = profiles(_measurement(store, row.owner, row.measurement, row.name), horizon_cutoff=options.horizon_cutoff)
    return encode_figure(_FIGURES[figure](reduced, model), image_format)


def _measurement(store: Store, owner: str, sha256: str, name: str | None = None) -> Measurement:
    """Return a stored measurement, whose file is mapped; raises as `Store.measurement_file`."""
    measurement = map_merl(store.measurement_file(owner, sha256), sha256)
    return replace(measurement, name=name or sha256[:12])
