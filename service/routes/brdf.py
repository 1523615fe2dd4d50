"""BRDF values of a fit and of its components."""

import re
from collections.abc import Callable, Coroutine
from typing import Annotated, Any
from urllib.parse import parse_qsl

from fastapi import APIRouter, Path, Request
from fastapi.routing import APIRoute
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from dsbrdf import InvalidArgumentError
from dsbrdf.model.decomposition import LABELS
from service.access.authentication import fit_of
from service.context import Context, context_of
from service.http import examples, openapi
from service.http.problems import ProblemError, sentence
from service.http.request_body import receive_small
from service.routes.fits import FitId
from service.wire.points import NPY, Points, from_angles, from_directions, from_npy, from_query
from service.wire.schemas import AnglesRequest, DirectionsRequest, Values
from service.wire.values_stream import JSON, values_reply


class _DirectRoute(APIRoute):
    """A route whose function is called with the request and its path parameters as they are.

    FastAPI describes it like any other. Having nothing solved and validated takes a third off a GET; an id or a
    label that nothing can have is one that is not found.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return what answers a request."""

        async def answer(request: Request) -> Response:
            response: Response = await self.endpoint(request, **request.path_params)
            return response

        return answer


router = APIRouter(prefix="/v1/fits/{fit_id}", tags=["values"], route_class=_DirectRoute)
Label = Annotated[
    str,
    Path(pattern=f"^({'|'.join(LABELS)})$", description=f"One of {', '.join(LABELS)}.", examples=[LABELS[0]]),
]

_MOST_JSON_POINTS = 100_000  # read into lists, numbers take up to sixteen times the memory of their text
_JSON_BYTES_A_POINT = 160  # six numbers with all their digits
_NPY_BYTES_A_POINT = 48
_DIRECTIONS_FIRST = re.compile(rb'\s*\{\s*"omega_')
_ASKED = openapi.example(examples.VALUES, "One RGB triple for each point.") | openapi.problems(
    "not-found", "fit-not-finished", "invalid-argument"
)
_POSTED = openapi.batch_answer() | openapi.problems(
    "not-found", "not-acceptable", "fit-not-finished", "too-large", "unsupported-media-type", "invalid-argument"
)


@router.get(
    "/brdf",
    response_model=Values,
    summary="Values at some points",
    responses=_ASKED,
    openapi_extra=openapi.point_query(),
)
async def get_values(request: Request, fit_id: FitId) -> Response:
    """Return the fit's values; parameters repeat for several points."""
    return await _asked(request, fit_id, None)


@router.get(
    "/lobes/{label}/brdf",
    response_model=Values,
    summary="A component's values at some points",
    responses=_ASKED,
    openapi_extra=openapi.point_query(),
)
async def get_component_values(request: Request, fit_id: FitId, label: Label) -> Response:
    """Return one component's values; the three components' values add up to the fit's."""
    return await _asked(request, fit_id, label)


@router.post(
    "/brdf",
    response_model=Values,
    summary="Values at many points",
    responses=_POSTED,
    openapi_extra=openapi.point_batch(),
)
async def post_values(request: Request, fit_id: FitId) -> Response:
    """Return the fit's values at a batch of points, JSON or .npy in, by `Accept` JSON or .npy out.

    A .npy array holds (n, 2) half and difference angles in degrees, or (n, 6) or (n, 2, 3) directions;
    the answer is (n, 3) float64. JSON may have 100,000 points, .npy a million.
    """
    return await _posted(request, fit_id, None)


@router.post(
    "/lobes/{label}/brdf",
    response_model=Values,
    summary="A component's values at many points",
    responses=_POSTED,
    openapi_extra=openapi.point_batch(),
)
async def post_component_values(request: Request, fit_id: FitId, label: Label) -> Response:
    """Return one component's values at a batch of points, as for the whole fit."""
    return await _posted(request, fit_id, label)


async def _asked(request: Request, fit_id: str, label: str | None) -> Response:
    context = context_of(request)
    model = await context.models.part(fit_of(request, fit_id), label)
    points = from_query(parse_qsl(request.scope["query_string"].decode("latin-1"), keep_blank_values=True))
    return await values_reply(model, points, JSON, context.metrics)


async def _posted(request: Request, fit_id: str, label: str | None) -> Response:
    context = context_of(request)
    media_type = _wanted_type(request)
    model = await context.models.part(fit_of(request, fit_id), label)
    points = await _batch(request, context)
    if len(points) > context.settings.max_points:
        detail = f"{len(points)} points are more than the {context.settings.max_points} that one request may have."
        raise ProblemError("too-large", detail)
    return await values_reply(model, points, media_type, context.metrics)


async def _batch(request: Request, context: Context) -> Points:
    """Return the points in the body."""
    media_type = request.headers.get("content-type", JSON).partition(";")[0].strip().lower()
    most = context.settings.max_points
    if media_type == NPY:
        body = await receive_small(request, most * _NPY_BYTES_A_POINT + 4096)
        return await run_in_threadpool(from_npy, body)
    if media_type == JSON:
        most = min(most, _MOST_JSON_POINTS)
        text = bytes(await receive_small(request, most * _JSON_BYTES_A_POINT + 4096))
        if text.count(b",") > 6 * most:
            raise ProblemError("too-large", f"A JSON body may have {most} points; send more of them as {NPY}.")
        return await run_in_threadpool(_from_json, text)
    detail = f"The content type {media_type[:60]!r} is not supported; send {JSON} or {NPY}."
    raise ProblemError("unsupported-media-type", detail, {"Accept-Post": f"{JSON}, {NPY}"})


def _from_json(body: bytes) -> Points:
    # Which of the two documents is meant shows in the message for one that is neither.
    directions = _DIRECTIONS_FIRST.match(body)
    try:
        if directions:
            vectors = DirectionsRequest.model_validate_json(body, strict=True)
            return from_directions(vectors.omega_in, vectors.omega_out)
        angles = AnglesRequest.model_validate_json(body, strict=True)
    except ValidationError as error:
        raise InvalidArgumentError(sentence(error.errors())) from None
    return from_angles(angles.theta_half_deg, angles.theta_diff_deg)


def _wanted_type(request: Request) -> str:
    """Return which of JSON and .npy ``Accept`` prefers; what is said of a type itself goes before any range."""
    ranges: dict[str, float] = {}
    for entry in ",".join(request.headers.getlist("accept")).split(","):
        media_type, *parameters = (part.strip().lower() for part in entry.split(";"))
        if media_type:
            ranges[media_type] = max(ranges.get(media_type, 0.0), _quality(parameters))

    def weight(name: str, in_range: float) -> float:
        if name in ranges:
            return ranges[name]
        return in_range * ranges.get("application/*", ranges.get("*/*", 0.0 if ranges else 1.0))

    json, npy = weight(JSON, 0.5), weight(NPY, 0.25)  # a type that is named counts more; JSON is the default
    if not (json or npy):
        raise ProblemError("not-acceptable", f"The values can be had as {JSON} or {NPY}; accept one of them.")
    return NPY if npy > json else JSON


def _quality(parameters: list[str]) -> float:
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                return min(max(float(value), 0.0), 1.0)
            except ValueError:
                return 1.0
    return 1.0
