"""Describe the service itself: liveness, readiness, metrics, the OpenAPI document and the files of the web page."""

import json
from typing import Literal

from fastapi import APIRouter
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

import dsbrdf

from ..errors import ProblemError
from ..http import openapi
from ..http.messages import JSON
from ..http.static_files import StaticFile, file_at
from .context import CHECKED_QUERY, TheCaller, TheContext


class Health(BaseModel):
    """The state of the service."""

    status: Literal["live", "ready"]
    version: str


router = APIRouter(tags=["health"], dependencies=CHECKED_QUERY)
page = APIRouter(include_in_schema=False)


@router.get("/health/live", responses=openapi.problems(behind_a_key=False))
async def get_live() -> Health:
    """Return 200 as long as the process runs."""
    return Health(status="live", version=dsbrdf.__version__)


@router.get("/health/ready", responses=openapi.problems("not-ready", behind_a_key=False))
async def get_ready(context: TheContext) -> Health:
    """Return 200 if the database and files can be written, the disk has space, and fits can run; otherwise 503.

    The answer comes within 3 s.
    """
    fault = await context.readiness.fault()
    if fault is not None:
        raise ProblemError("not-ready", fault)
    return Health(status="ready", version=dsbrdf.__version__)


@router.get("/metrics", response_class=PlainTextResponse, responses=openapi.problems("not-found"))
async def get_metrics(context: TheContext, caller: TheCaller) -> Response:
    """Return counts, times and sizes over all keys in Prometheus' text format; a key needs permission to read them."""
    if not caller.metrics:
        raise ProblemError("not-found", "This key may not read the metrics; make a key with dsbrdf keys add --metrics.")
    metrics = await run_in_threadpool(context.metrics.exposition, context.store)
    return Response(metrics, media_type=CONTENT_TYPE_PLAIN_0_0_4)


@page.get("/")
@page.get("/compare")
@page.get("/fits/{name}")
@page.get("/measurements/{name}")
@page.get("/docs")
@page.get("/docs/{name}")
@page.get("/page/{name}")
async def get_file(request: Request) -> Response:
    """Return the web page or another static file; the page requests all data from ``/v1``."""
    file = file_at(request.scope["path"])
    if file is None:
        raise HTTPException(404)
    return await run_in_threadpool(file.reply, request)


@page.get("/openapi.json")
async def get_openapi(request: Request) -> Response:
    """Return the OpenAPI document."""
    state = request.app.state
    if not hasattr(state, "openapi"):
        state.openapi = StaticFile(json.dumps(request.app.openapi()).encode(), JSON)
    return await run_in_threadpool(state.openapi.reply, request)
