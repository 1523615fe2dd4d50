"""Liveness and readiness."""

import shutil
import sqlite3

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

import dsbrdf
from service import openapi
from service.context import Context, context_of
from service.problems import ProblemError
from service.replies import json_reply
from service.schemas import Health

router = APIRouter(prefix="/health", tags=["health"])


@router.get("/live", response_model=Health, summary="Is the process alive?", responses=openapi.health("live"))
async def get_live() -> Response:
    """Answer whenever the process answers at all."""
    return json_reply(Health(status="live", version=dsbrdf.__version__))


@router.get(
    "/ready",
    response_model=Health,
    summary="Can it take work?",
    responses=openapi.health("ready") | openapi.problems("not-ready"),
)
async def get_ready(request: Request) -> Response:
    """Answer 200 if rows and files can be written, there is disk space, and fits can run; otherwise 503."""
    context = context_of(request)
    fault = await run_in_threadpool(_storage_fault, context)
    if fault is None:
        try:
            await context.engine.check()
        except RuntimeError as error:
            fault = str(error)
    if fault is not None:
        raise ProblemError("not-ready", fault, {"Retry-After": "10"})
    return json_reply(Health(status="ready", version=dsbrdf.__version__))


def _storage_fault(context: Context) -> str | None:
    try:
        context.store.check()
    except (OSError, sqlite3.Error) as error:
        return f"The data folder cannot be written to: {error}."
    free = shutil.disk_usage(context.store.folder).free >> 20
    if free < context.settings.min_free_mb:
        return f"The disk has {free} MB free; the service wants {context.settings.min_free_mb} MB."
    return None
