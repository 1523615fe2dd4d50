"""Evaluate BRDF values of fits, of their components, and of measurements."""

from functools import partial
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Path, Request
from fastapi.routing import APIRoute
from pydantic import BaseModel
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from dsbrdf.components.shares import LABELS
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.reflectance import ReflectanceModel

from ..access import CALLER
from ..compute.steps import Array, StoredMeasurement, measured_step, npy_bytes
from ..errors import ProblemError
from ..http import openapi
from ..http.messages import JSON, NPY, long_reply, media_type_of, prefers
from ..storage.schema import FitKey
from .context import Context, TheContext, TheFit, TheMeasurement, check_query
from .fields import Label, Rgb
from .points import FORMS, Points, batch_step, from_json, from_npy, from_query


class _DirectRoute(APIRoute):
    """Call a route's function with its dependencies and path parameters, without FastAPI's validation.

    The OpenAPI document describes the route like any other. Without FastAPI's dependencies, validation and exit stacks,
    a GET takes a third less time. An invalid id is answered as not found.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.app = self._answer

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        request, parameters = Request(scope, receive, send), scope["path_params"]
        fit = FitKey(scope[CALLER].owner, parameters.pop("fit_id"))
        response: Response = await self.endpoint(request, scope["app"].state.context, fit, **parameters)
        await response(scope, receive, send)


class Values(BaseModel):
    """BRDF values, one RGB triple for each point [1/sr]."""

    values: list[Rgb]


class MeasuredValues(BaseModel):
    """Values of a measurement, one RGB triple for each point [1/sr]; null where nothing was measured."""

    values: list[Rgb | None]


router = APIRouter(prefix="/v1/fits/{fit_id}", tags=["values"], route_class=_DirectRoute)
measured = APIRouter(prefix="/v1/measurements/{sha256}/brdf", tags=["values"])
_Component = Annotated[Label, Path(description=f"One of {', '.join(LABELS)}.", examples=[LABELS[0]])]

_MAX_INLINE_POINTS = 64  # More points are evaluated in a thread; for fewer, the change of thread would take longer.
_BLOCK_POINTS = 4096  # Points are evaluated in blocks of this size; larger blocks take more memory and are not faster.
_MAX_BODY_BYTES = 16_000_000  # This is the size of 100,000 pairs of directions as JSON with all digits.
_MAX_POINTS = 100_000
_MAX_INLINE_JSON_BYTES = 1 << 20  # A process parses longer JSON, which would block all threads for over 50 ms.


def _query_parameter(name: str, schema: dict[str, Any]) -> dict[str, Any]:
    """Return the OpenAPI declaration of a query parameter, from the JSON schema of the member with this name."""
    several = schema.get("anyOf", [schema])[0]
    is_vector = several["items"]["type"] == "array"
    described = {
        "description": schema.get("description", "Angles in degrees") + (", as x,y,z" * is_vector),
        "schema": {"type": "array", "items": _VECTOR if is_vector else several["items"]},
    }
    example = {"example": schema["examples"][0]} if "examples" in schema else {}
    return {"name": name, "in": "query", "explode": True, **described, **example}


_VECTOR = {"type": "string", "pattern": r"^[^,]+,[^,]+,[^,]+$"}
_MEMBERS = (member for form in FORMS for member in form.model_json_schema()["properties"].items())
_QUERY = {"parameters": [_query_parameter(name, schema) for name, schema in _MEMBERS]}
_BATCH = openapi.body(
    "Points, in degrees or as unit vectors.",
    {
        JSON: {"schema": {"oneOf": [openapi.reference(form) for form in FORMS]}, "examples": openapi.EXAMPLE_POINTS},
        NPY: openapi.file(NPY),
    },
) | {"parameters": [openapi.header_parameter("Accept", f"`{NPY}` asks for the values as an array.")]}
_GET_PROBLEMS = openapi.problems("not-found", "fit-not-finished")
_POST_RESPONSES = {
    200: {"description": "One RGB triple for each point.", "content": {NPY: openapi.file(NPY)}},
    **openapi.problems("not-found", "fit-not-finished", "too-large", *openapi.BODY_PROBLEMS),
}
_OF_MEASUREMENT = openapi.problems("not-found", "measurement-damaged")
_get = partial(router.get, response_model=Values, responses=_GET_PROBLEMS, openapi_extra=_QUERY)
_post = partial(router.post, response_model=Values, responses=_POST_RESPONSES, openapi_extra=_BATCH)


@_get("/brdf")
async def get_values(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return BRDF values of a fit; repeat each parameter for several points."""
    return await _values(request, context, fit, None)


@_get("/components/{label}/brdf")
async def get_component_values(request: Request, context: TheContext, fit: TheFit, label: _Component) -> Response:
    """Return the values of one component; the values of all components add up to those of the fit."""
    return await _values(request, context, fit, label)


@_post("/brdf")
async def post_values(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return BRDF values of a fit at a batch of points; body and answer are JSON or .npy.

    `Accept` chooses the type of the answer. A .npy array holds (n, 2) or (n, 3) angles in degrees: theta_half,
    theta_diff and, where it is not 90, phi_diff; or pairs of directions, (n, 6) or (n, 2, 3). The answer is (n, 3)
    float64, 0 where a direction is below the horizon. A request has at most 100,000 points.
    """
    return await _values(request, context, fit, None)


@_post("/components/{label}/brdf")
async def post_component_values(request: Request, context: TheContext, fit: TheFit, label: _Component) -> Response:
    """Return the values of one component at a batch of points, in the formats of the whole fit's values."""
    return await _values(request, context, fit, label)


@measured.get("", response_model=MeasuredValues, responses=_OF_MEASUREMENT, openapi_extra=_QUERY)
async def get_measured_values(request: Request, context: TheContext, stored: TheMeasurement) -> Response:
    """Return the measurement's own values, interpolated between its nodes; repeat each parameter for several points.

    A value is null if no neighbouring node was measured, for example below the horizon.
    """
    return await _measured_values(request, context, stored)


@measured.post("", response_model=MeasuredValues, responses=_OF_MEASUREMENT | _POST_RESPONSES, openapi_extra=_BATCH)
async def post_measured_values(request: Request, context: TheContext, stored: TheMeasurement) -> Response:
    """Return the measurement's own values at a batch of points, as for a fit; NaN in .npy stands for null."""
    return await _measured_values(request, context, stored)


async def _values(request: Request, context: Context, fit: FitKey, label: str | None) -> Response:
    """Return values of a fit or a component; values at many points wait for the caller's turn."""
    try:
        points, media_type = await _points(request, context)
    except (InvalidArgumentError, ProblemError):
        # If the fit or the component does not exist, this reports the wrong address instead of the wrong points.
        (await context.models.get(fit)).part(label)
        raise
    if points.theta_half.size <= _MAX_INLINE_POINTS and media_type == JSON:
        values = await context.models.evaluate(fit, label, *points)
        return Response(to_json({"values": values.tolist()}), media_type=JSON)
    model = (await context.models.get(fit)).part(label)
    content = await context.computations.run(request, lambda: _encoded(_in_blocks(model, points), media_type))
    return await long_reply(context.store.writing, request.scope[CALLER], content, {"Content-Type": media_type})


async def _measured_values(request: Request, context: Context, stored: StoredMeasurement) -> Response:
    """Return a measurement's values, interpolated in a separate process."""
    points, media_type = await _points(request, context)
    values = await context.in_process(request, measured_step, stored, *points)
    content = await run_in_threadpool(_encoded, values, media_type)
    return await long_reply(context.store.writing, request.scope[CALLER], content, {"Content-Type": media_type})


async def _points(request: Request, context: Context) -> tuple[Points, str]:
    """Return the points of a query or a body, and the media type of the answer.

    The points of a body are parsed in the queue of computations; a long JSON text is parsed in a separate process.
    """
    if request.method == "GET":
        return from_query(request.scope["query_string"]), JSON
    await check_query(request)
    media_type = media_type_of(request, JSON, NPY)
    async with context.bodies.received(request, _MAX_BODY_BYTES) as body:
        if len(body) > _MAX_INLINE_JSON_BYTES and media_type == JSON:
            points = await context.computations.run_in_process(request, batch_step, body)
        else:
            read = from_npy if media_type == NPY else from_json
            points = await context.computations.run(request, partial(read, body))
    if (count := points.theta_half.size) > _MAX_POINTS:
        detail = f"{count} points are more than the {_MAX_POINTS} of one request; send several requests."
        raise ProblemError("too-large", detail)
    return points, NPY if prefers(request, NPY, JSON) else JSON


def _in_blocks(model: ReflectanceModel, points: Points) -> Array:
    """Return a model's values, computed in blocks to save memory."""
    starts = range(0, points.theta_half.size, _BLOCK_POINTS)
    values = [model.evaluate(*(angle[start : start + _BLOCK_POINTS] for angle in points)) for start in starts]
    return np.concatenate([*values, np.empty((0, 3))])


def _encoded(values: Array, media_type: str) -> bytes:
    """Return values as .npy or JSON, with null for NaN; JSON is encoded in blocks, between which other threads run.

    pydantic's encoder takes a ninth of the time of Python's encoder, but blocks all other threads.
    """
    if media_type == NPY:
        return npy_bytes(values)
    triples: list[list[float] | None] = values.tolist()
    for row in np.flatnonzero(np.isnan(values[:, 0])):
        triples[row] = None
    blocks = (to_json(triples[start : start + _BLOCK_POINTS]) for start in range(0, len(triples), _BLOCK_POINTS))
    return b'{"values":[%b]}' % b",".join(block[1:-1] for block in blocks)
