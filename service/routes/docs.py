"""The documentation as a page. All that it loads comes from the service, so it works without the internet too."""

from importlib.resources import files

from fastapi import APIRouter
from starlette.concurrency import run_in_threadpool
from starlette.responses import HTMLResponse, Response

from service.http.responses import IfNoneMatch, tagged_reply

router = APIRouter(include_in_schema=False)

# Addresses are relative: they hold behind a proxy that puts something in front of them.
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>dsbrdf</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="docs/swagger-ui.css">
</head>
<body>
<div id="page"></div>
<script src="docs/swagger-ui-bundle.js"></script>
<script src="docs/page.js"></script>
</body>
</html>
"""
_SCRIPT = b"""SwaggerUIBundle({ url: "openapi.json", dom_id: "#page", deepLinking: true, validatorUrl: null });
"""
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
_STATIC = files("fastapi_offline") / "static"  # Swagger UI


@router.get("/docs")
async def get_docs() -> Response:
    """Return the page that shows the OpenAPI document."""
    return HTMLResponse(_PAGE, headers={"Content-Security-Policy": _POLICY})


@router.get("/docs/page.js")
async def get_script(if_none_match: IfNoneMatch = "") -> Response:
    """Return the script that starts the page."""
    return tagged_reply(_SCRIPT, if_none_match, media_type="text/javascript")


@router.get("/docs/swagger-ui-bundle.js")
async def get_bundle(if_none_match: IfNoneMatch = "") -> Response:
    """Return the script of Swagger UI."""
    content = await run_in_threadpool((_STATIC / "swagger-ui-bundle.js").read_bytes)
    return tagged_reply(content, if_none_match, media_type="text/javascript")


@router.get("/docs/swagger-ui.css")
async def get_style(if_none_match: IfNoneMatch = "") -> Response:
    """Return the style sheet of Swagger UI."""
    content = await run_in_threadpool((_STATIC / "swagger-ui.css").read_bytes)
    return tagged_reply(content, if_none_match, media_type="text/css")
