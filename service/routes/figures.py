"""Pictures of fits."""

from typing import Annotated

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Query
from starlette.responses import Response

from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import render_sphere, sphere_normals
from dsbrdf.output.png import encode_png
from service.http import openapi
from service.http.responses import IfNoneMatch, tagged_reply
from service.routes.dependencies import TheContext, TheFit
from service.wire.schemas import Sphere

router = APIRouter(prefix="/v1/fits", tags=["figures"])

_PNG = "image/png"
_rendering = CapacityLimiter(1)  # a picture takes a core for up to half a second, and some 50 MB


@router.get(
    "/{fit_id}/figures/sphere.png",
    response_class=Response,
    summary="A lit sphere of a fit",
    responses=openapi.response("The picture.", content={_PNG: openapi.file(_PNG)}, headers=["ETag"])
    | openapi.NOT_MODIFIED
    | openapi.problems("not-found", "fit-not-finished", "invalid-argument"),
)
async def draw_sphere(
    context: TheContext, fit: TheFit, wanted: Annotated[Sphere, Query()], if_none_match: IfNoneMatch = ""
) -> Response:
    """Return a picture of a sphere of the fit, or of one component, with the exposure of the whole fit.

    The 99th percentile of the whole fit's sphere becomes 1; what is brighter is clipped; then comes the sRGB curve.
    """
    whole = await context.models.component(fit, None)
    part = await context.models.component(fit, wanted.component)
    picture = await to_thread.run_sync(_sphere, whole, part, wanted, limiter=_rendering)
    return tagged_reply(picture, if_none_match, _PNG)


def _sphere(whole: DSBRDF, part: DSBRDF, wanted: Sphere) -> bytes:
    image = render_sphere(whole, lighting=wanted.lighting, size=wanted.size)
    factor = exposure(image, sphere_normals(wanted.size)[1])
    if part is not whole:
        image = render_sphere(part, lighting=wanted.lighting, size=wanted.size)
    return encode_png(displayed(image, factor))
