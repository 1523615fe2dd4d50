"""BRDF values of a fit and of its components, and the components themselves."""

from functools import partial
from io import BytesIO
from typing import Annotated, Any
from urllib.parse import parse_qsl

import numpy as np
from fastapi import APIRouter, Path, Request
from fastapi.routing import APIRoute
from numpy.lib import format as npy_format
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.layer_shares import LABELS
from dsbrdf.model.reflectance import ReflectanceModel

from ..access.authentication import CALLER_NAME
from ..http import openapi
from ..http.request_body import media_type_of
from ..http.responses import prefers, tagged_reply
from ..jobs.results import LoadedFit
from ..jobs.steps import StoredMeasurement, measured_step
from ..operations.metrics import Metrics
from ..storage.schema import FitKey
from ..wire.points import (
    ANGLES,
    DIRECTIONS,
    JSON,
    NPY,
    PHI_DIFF,
    SIDES,
    TURNS,
    Array,
    Points,
    batch_step,
    check_count,
    from_json,
    from_npy,
    from_query,
)
from ..wire.schemas import ComponentList, MeasuredValues, Values
from .dependencies import (
    NO_QUERY,
    Context,
    TheContext,
    TheFit,
    TheLoadedFit,
    TheMeasurement,
    caller_of,
    context_of,
    fit_key,
    no_query,
)


class _DirectRoute(APIRoute):
    """A route whose function gets its dependencies and path parameters without FastAPI's validation.

    FastAPI describes it like any other. A GET takes a third less time without FastAPI's solving of dependencies,
    validation and exit stacks; an id that nothing can have is not found.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.app = self._answer

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        request, parameters = Request(scope, receive, send), scope["path_params"]
        context, caller = await context_of(request), await caller_of(request)
        fit = await fit_key(caller, parameters["fit_id"])
        labels = {"label": parameters["label"]} if "label" in parameters else {}
        response: Response = await self.endpoint(request, context, fit, **labels)
        await response(scope, receive, send)


router = APIRouter(prefix="/v1/fits/{fit_id}", tags=["values"], route_class=_DirectRoute)
measured = APIRouter(prefix="/v1/measurements/{sha256}/brdf", tags=["values"])
components = APIRouter(prefix="/v1/fits/{fit_id}/components", tags=["components"])
Label = Annotated[
    str,
    Path(pattern=f"^({'|'.join(LABELS)})$", description=f"One of {', '.join(LABELS)}.", examples=[LABELS[0]]),
]

_MAX_INLINE = 64  # points: so few are evaluated faster than a thread is started
_BLOCK = 4096  # points that are evaluated at a time
_MAX_BODY = 16_000_000  # bytes: a hundred thousand pairs of directions as JSON, with all digits
_MUCH_JSON = 1 << 20  # bytes that are read in some 50 ms, in which no other thread runs


def _point_parameter(name: str, description: str, items: dict[str, Any], **example: Any) -> dict[str, Any]:
    schema = {"type": "array", "items": items}
    return {"name": name, "in": "query", "explode": True, "description": description, "schema": schema, **example}


_ANGLE = {"type": "number", "minimum": 0, "maximum": 90}
_VECTOR = {"type": "string", "pattern": r"^[^,]+,[^,]+,[^,]+$"}
_IN_DEGREES = "Angles in degrees; repeat for several points."
_TO_NORMAL = "Angles to the normal in degrees, instead of half and difference angles; repeat for several points."
_ABOUT_NORMAL = f"{_IN_DEGREES} Where they are left out, 0 of omega_in and 180, the other side, of omega_out."
_UNIT_VECTORS = "Unit vectors x,y,z; repeat for several points. Values are 0 where one is below the horizon (z < 0)."
_QUERY = {
    "parameters": [
        _point_parameter(ANGLES[0], _IN_DEGREES, _ANGLE, example=[10]),
        _point_parameter(ANGLES[1], _IN_DEGREES, _ANGLE, example=[30]),
        _point_parameter(PHI_DIFF, f"{_IN_DEGREES} 90 where it is left out.", {"type": "number"}, example=[90]),
        *(_point_parameter(name, _TO_NORMAL, _ANGLE) for name in SIDES),
        *(_point_parameter(name, _ABOUT_NORMAL, {"type": "number"}) for name in TURNS),
        *(_point_parameter(name, _UNIT_VECTORS, _VECTOR) for name in DIRECTIONS),
    ]
}
_BATCH = openapi.body(
    "Points, in degrees or as unit vectors.",
    {
        JSON: {
            "schema": {"oneOf": [openapi.reference(kind) for kind in openapi.POINTS]},
            "examples": openapi.EXAMPLE_POINTS,
        },
        NPY: openapi.file(NPY),
    },
) | {"parameters": [openapi.ENCODING]}
_GET_PROBLEMS = openapi.problems("not-found", "fit-not-finished", "invalid-argument")
_POST_RESPONSES = openapi.response("One RGB triple for each point.", {NPY: openapi.file(NPY)}) | openapi.problems(
    "not-found", "fit-not-finished", "too-large", "invalid-argument", *openapi.BODY_PROBLEMS
)
_OF_MEASUREMENT = openapi.problems("not-found", "measurement-damaged", "invalid-argument")
_get = partial(router.get, response_model=Values, responses=_GET_PROBLEMS, openapi_extra=_QUERY)
_post = partial(router.post, response_model=Values, responses=_POST_RESPONSES, openapi_extra=_BATCH)


@_get("/brdf", summary="Values at some points")
async def get_values(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return the fit's values; parameters repeat for several points."""
    return await _values_of_query(request, context, fit, None)


@_get("/components/{label}/brdf", summary="A component's values at some points")
async def get_component_values(request: Request, context: TheContext, fit: TheFit, label: Label) -> Response:
    """Return one component's values; those of all components add up to the fit's. One without light is not found."""
    return await _values_of_query(request, context, fit, label)


@_post("/brdf", summary="Values at many points")
async def post_values(request: Request, context: TheContext, fit: TheFit) -> Response:
    """Return the fit's values at a batch of points, JSON or .npy in, by `Accept` JSON or .npy out.

    A .npy array holds (n, 2) or (n, 3) angles in degrees: theta_half, theta_diff and, where it is not 90, phi_diff;
    or (n, 6) or (n, 2, 3) directions. The answer is (n, 3) float64, 0 where a direction is below the horizon.
    A request has at most 100,000 points.
    """
    return await _values_of_batch(request, context, fit, None)


@_post("/components/{label}/brdf", summary="A component's values at many points")
async def post_component_values(request: Request, context: TheContext, fit: TheFit, label: Label) -> Response:
    """Return one component's values at a batch of points, as for the whole fit."""
    return await _values_of_batch(request, context, fit, label)


@measured.get(
    "", response_model=MeasuredValues, summary="A measurement's values", responses=_OF_MEASUREMENT, openapi_extra=_QUERY
)
async def get_measured_values(request: Request, context: TheContext, stored: TheMeasurement) -> Response:
    """Return the measurement's own values, interpolated between its nodes; parameters repeat for several points.

    A value is null where no node beside it was measured, as below the horizon.
    """
    points = from_query(parse_qsl(request.scope["query_string"].decode("latin-1"), keep_blank_values=True))
    return await _measured_reply(request, context, stored, points, JSON)


@measured.post(
    "",
    response_model=MeasuredValues,
    summary="A measurement's values at many points",
    responses=_OF_MEASUREMENT | _POST_RESPONSES,
    openapi_extra=_BATCH,
)
async def post_measured_values(request: Request, context: TheContext, stored: TheMeasurement) -> Response:
    """Return the measurement's own values at a batch of points, as for a fit; NaN in .npy stands for null."""
    await no_query(request)
    media_type = NPY if prefers(request, NPY, JSON) else JSON
    return await _measured_reply(request, context, stored, await _batch(request, context), media_type)


@components.get(
    "",
    dependencies=NO_QUERY,
    response_model=ComponentList,
    summary="The components of a fit",
    responses=openapi.NOT_MODIFIED | openapi.problems("not-found", "fit-not-finished"),
)
async def get_components(request: Request, fit: TheLoadedFit) -> Response:
    """Return the components that have light: specular spike, specular lobe, diffuse, or some of them.

    Each has a lobe of its own, as values at some angles, its albedo, colour, half width and how clear the split is.
    """
    return tagged_reply(request, ComponentList.model_validate({"items": fit.components}))


async def _values_of_query(request: Request, context: Context, fit: FitKey, label: str | None) -> Response:
    loaded = await _loaded(context, fit, label)
    points = from_query(parse_qsl(request.scope["query_string"].decode("latin-1"), keep_blank_values=True))
    return await _reply(request, context, loaded.part(label), points, JSON)


async def _values_of_batch(request: Request, context: Context, fit: FitKey, label: str | None) -> Response:
    await no_query(request)
    media_type = NPY if prefers(request, NPY, JSON) else JSON
    loaded = await _loaded(context, fit, label)
    points = await _batch(request, context)
    return await _reply(request, context, loaded.part(label), points, media_type)


async def _measured_reply(
    request: Request, context: Context, stored: StoredMeasurement, points: Points, media_type: str
) -> Response:
    """Return a measurement's values, which a process of its own interpolates."""
    angles = points.theta_half, points.theta_diff, points.phi_diff
    head = {"Content-Type": media_type}
    values = await context.in_process(request, object(), measured_step, stored, *angles)
    if media_type == NPY:
        return Response(_npy_head(len(points)) + values.tobytes(), 200, head)
    triples = [None if np.isnan(triple[0]) else triple for triple in values.tolist()]
    return Response(await run_in_threadpool(to_json, {"values": triples}), 200, head)


async def _loaded(context: Context, fit: FitKey, label: str | None) -> LoadedFit:
    """Return a fit; raise what is wrong with it or with the label, which goes before what is wrong with the points."""
    loaded = await context.models.get(fit)
    if label is not None and label not in LABELS:
        raise InvalidArgumentError(f"The component must be one of {', '.join(LABELS)}, not {label[:40]!r}.")
    return loaded


async def _reply(
    request: Request, context: Context, model: ReflectanceModel, points: Points, media_type: str
) -> Response:
    """Return the values of a model: a few at once, more in a turn."""
    compute = partial(_content, model, points, media_type, context.metrics)
    if len(points) <= _MAX_INLINE:
        return Response(compute(), 200, media_type=media_type)
    content = await context.computations.run(request, object(), compute)
    return Response(content, 200, media_type=media_type)


async def _batch(request: Request, context: Context) -> Points:
    """Return the points in the body; many of them are read in a turn, and much JSON in a process of its own."""
    media_type = media_type_of(request, JSON, NPY)
    async with context.bodies.received(request, _MAX_BODY, request.scope[CALLER_NAME]) as body:
        if media_type == NPY:
            return await context.computations.run(request, object(), partial(from_npy, body))
        if len(body) <= _MUCH_JSON:
            points = await context.computations.run(request, object(), partial(from_json, body))
        else:
            points = await context.computations.run_in_process(request, object(), batch_step, body)
    check_count(len(points))
    return points


def _npy_head(n_points: int) -> bytes:
    header = BytesIO()
    npy_format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (n_points, 3)})
    return header.getvalue()


def _json_triples(values: Array) -> bytes:
    """Return triples as JSON; pydantic's encoder takes a ninth of the time of Python's, and all other threads wait."""
    if not np.isfinite(values).all():
        raise ValueError("JSON has no infinity, and no value of a model may be infinite")
    return to_json(values.tolist())[1:-1]


def _content(model: ReflectanceModel, points: Points, media_type: str, metrics: Metrics) -> bytes:
    """Return a model's values as .npy or JSON, computed in blocks so that other threads have their turn."""
    with metrics.timing("evaluating"):
        blocks = [slice(start, start + _BLOCK) for start in range(0, len(points), _BLOCK)]
        values = (points.part(block).values(model) for block in blocks)
        if media_type == NPY:
            return b"".join((_npy_head(len(points)), *(block.tobytes() for block in values)))
        return b'{"values":[%b]}' % b",".join(map(_json_triples, values))
