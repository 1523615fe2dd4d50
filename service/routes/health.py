"""Liveness, readiness and metrics."""

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import PlainTextResponse, Response

import dsbrdf
from service.context import context_of
from service.http import openapi
from service.http.problems import ProblemError
from service.http.responses import json_reply
from service.operations.metrics import MEDIA_TYPE
from service.wire.schemas import Health

router = APIRouter(tags=["health"])

_EXAMPLE = """# HELP dsbrdf_fits Fits by state; the accepted ones are the queue.
# TYPE dsbrdf_fits gauge
dsbrdf_fits{state="running"} 2.0
"""
_EXPOSITION: openapi.Responses = {
    200: {
        "description": "Metrics in Prometheus' text format.",
        "content": {"text/plain": {"schema": {"type": "string"}, "example": _EXAMPLE}},
    }
}


@router.get("/health/live", response_model=Health, summary="Is the process alive?", responses=openapi.health("live"))
async def get_live() -> Response:
    """Answer whenever the process answers at all."""
    return json_reply(Health(status="live", version=dsbrdf.__version__))


@router.get(
    "/health/ready",
    response_model=Health,
    summary="Can it take work?",
    responses=openapi.health("ready") | openapi.problems("not-ready"),
)
async def get_ready(request: Request) -> Response:
    """Answer 200 if rows and files can be written, there is disk space, and fits can run; otherwise 503.

    The answer is at most a second old, and each part has 3 s to give its own.
    """
    fault = await context_of(request).readiness.fault()
    if fault is not None:
        raise ProblemError("not-ready", fault, {"Retry-After": "10"})
    return json_reply(Health(status="ready", version=dsbrdf.__version__))


@router.get("/metrics", response_class=PlainTextResponse, summary="Counts and times", responses=_EXPOSITION)
async def get_metrics(request: Request) -> Response:
    """Return requests, fits, times and sizes in Prometheus' text format."""
    return Response(await run_in_threadpool(context_of(request).metrics.exposition), media_type=MEDIA_TYPE)
