"""The documentation as a page. All that it loads comes from the service, so it works without the internet too."""

from importlib.resources import files

from fastapi import APIRouter
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from service.errors import NotFoundError
from service.http.responses import IfNoneMatch, tagged_reply

router = APIRouter(include_in_schema=False)

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
_SWAGGER_UI = files("fastapi_offline") / "static"
# Addresses in the page are relative: they hold behind a proxy that adds a prefix.
_PAGE, _SCRIPT = (files("service") / "page" / name for name in ("docs.html", "docs.js"))
_FILES = {
    "page.js": (_SCRIPT, "text/javascript"),
    "swagger-ui-bundle.js": (_SWAGGER_UI / "swagger-ui-bundle.js", "text/javascript"),
    "swagger-ui.css": (_SWAGGER_UI / "swagger-ui.css", "text/css"),
}


@router.get("/docs")
async def get_docs(if_none_match: IfNoneMatch = "") -> Response:
    """Return the page that shows the OpenAPI document."""
    content = await run_in_threadpool(_PAGE.read_bytes)
    return tagged_reply(content, if_none_match, "text/html; charset=utf-8", {"Content-Security-Policy": _POLICY})


@router.get("/docs/{name}")
async def get_file(name: str, if_none_match: IfNoneMatch = "") -> Response:
    """Return a script or the style sheet of the page."""
    if name not in _FILES:
        raise NotFoundError(f"There is nothing at /docs/{name[:60]}; GET /docs lists what there is.")
    file, media_type = _FILES[name]
    return tagged_reply(await run_in_threadpool(file.read_bytes), if_none_match, media_type)
