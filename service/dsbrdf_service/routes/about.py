"""What the service says about itself: liveness, readiness and metrics."""

from fastapi import APIRouter
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from starlette.concurrency import run_in_threadpool
from starlette.responses import PlainTextResponse, Response

import dsbrdf

from ..errors import ProblemError
from ..http import openapi
from ..wire.schemas import Health
from .dependencies import CHECKED_QUERY, TheCaller, TheContext

router = APIRouter(tags=["health"], dependencies=CHECKED_QUERY)


@router.get("/health/live", responses=openapi.problems(behind_a_key=False))
async def get_live() -> Health:
    """Answer whenever the process answers at all."""
    return Health(status="live", version=dsbrdf.__version__)


@router.get("/health/ready", responses=openapi.problems("not-ready", behind_a_key=False))
async def get_ready(context: TheContext) -> Health:
    """Answer 200 if rows and files can be written, there is disk space, and fits can run; otherwise 503.

    The answer comes within 3 s.
    """
    fault = await context.readiness.fault()
    if fault is not None:
        raise ProblemError("not-ready", fault)
    return Health(status="ready", version=dsbrdf.__version__)


@router.get("/metrics", response_class=PlainTextResponse, responses=openapi.problems("not-found"))
async def get_metrics(context: TheContext, caller: TheCaller) -> Response:
    """Return requests, fits, times and sizes of all in Prometheus' text format; an API key has to be made for that."""
    if not caller.metrics:
        raise ProblemError("not-found", "There are no metrics for this key; dsbrdf keys add --metrics makes one.")
    metrics = await run_in_threadpool(context.metrics.exposition, context.store.database)
    return Response(metrics, media_type=CONTENT_TYPE_PLAIN_0_0_4)
