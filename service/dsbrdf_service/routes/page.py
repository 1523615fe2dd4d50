"""The web page and the documentation as static files, and the OpenAPI document.

The page is one more client of ``/v1``: nothing else is answered for it.
"""

import json

from fastapi import APIRouter, HTTPException, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from ..http.static_files import StaticFile, file_at
from ..wire.points import JSON

router = APIRouter(include_in_schema=False)


@router.get("/")
@router.get("/compare")
@router.get("/fits/{name}")
@router.get("/measurements/{name}")
@router.get("/docs")
@router.get("/docs/{name}")
@router.get("/page/{name}")
async def get_file(request: Request) -> Response:
    """Return the page, which asks ``/v1`` for what its address names; or what is static beside it."""
    file = file_at(request.scope["path"])
    if file is None:
        raise HTTPException(404)
    return await run_in_threadpool(file.reply, request)


@router.get("/openapi.json")
async def get_openapi(request: Request) -> Response:
    """Return the OpenAPI document."""
    state = request.app.state
    if not hasattr(state, "openapi"):
        state.openapi = StaticFile(json.dumps(request.app.openapi()).encode(), JSON)
    return await run_in_threadpool(state.openapi.reply, request)
