"""Describe the service itself: liveness, readiness, metrics, the OpenAPI document and the web page.

The pages load nothing from the internet, and need no API key. Addresses in them are relative, so that they work behind
a proxy that adds a prefix.
"""

import json
from importlib.resources import files
from mimetypes import guess_type
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
from ..http.messages import BINARY, JSON, tagged_reply
from .context import CHECKED_QUERY, TheCaller, TheContext


class Health(BaseModel):
    """The state of the service."""

    status: Literal["live", "ready"]
    version: str


router = APIRouter(tags=["health"], dependencies=CHECKED_QUERY)
page = APIRouter(include_in_schema=False)
# The page may load its own scripts and styles, answers of the service, and pictures that the page itself makes.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
_FILES = {"page": files("dsbrdf_service.http") / "page", "docs": files("fastapi_offline") / "static"}
_PAGE, _DOCS = ((_FILES["page"] / name).read_text() for name in ("index.html", "docs.html"))


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
async def get_page(request: Request) -> Response:
    """Return the web page, which requests all data from ``/v1``, or the page that shows the OpenAPI document."""
    path = request.scope["path"]
    content = _DOCS if path == "/docs" else _PAGE
    if path.count("/") > 1:  # The relative addresses must fit the depth of the path.
        content = content.replace('="./', '="../')
    return tagged_reply(request, content.encode(), "text/html; charset=utf-8", {"Content-Security-Policy": _POLICY})


@page.get("/page/{name}")
@page.get("/docs/{name}")
def get_page_file(request: Request, name: str) -> Response:
    """Return a script or a style sheet of the web page, or a file of Swagger UI, which shows the OpenAPI document."""
    path = _FILES[request.scope["path"].split("/")[1]] / name
    if not path.is_file():
        raise HTTPException(404)
    return tagged_reply(request, path.read_bytes(), guess_type(name)[0] or BINARY)


@page.get("/openapi.json")
async def get_openapi(request: Request) -> Response:
    """Return the OpenAPI document."""
    state = request.app.state
    if not hasattr(state, "openapi"):
        state.openapi = json.dumps(request.app.openapi()).encode()
    return tagged_reply(request, state.openapi, JSON)
