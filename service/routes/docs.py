"""The documentation as a page, which may load what it names and run nothing else."""

import base64
import hashlib
import re

from fastapi import APIRouter, Request
from fastapi.openapi.docs import get_swagger_ui_html
from starlette.responses import HTMLResponse

router = APIRouter(include_in_schema=False)


@router.get("/docs")
async def get_docs(request: Request) -> HTMLResponse:
    """Return the page that shows the OpenAPI document."""
    url = f"{request.scope.get('root_path', '').rstrip('/')}/openapi.json"
    page = get_swagger_ui_html(openapi_url=url, title="dsbrdf")
    page.headers["Content-Security-Policy"] = _policy(bytes(page.body).decode())
    return page


def _policy(page: str) -> str:
    """Return the Content-Security-Policy that lets through what `page` needs: its scripts, styles and pictures."""
    scripts = re.findall(r'<script src="([^"]+)"', page)
    for inline in re.findall(r"<script>(.*?)</script>", page, re.DOTALL):
        digest = base64.b64encode(hashlib.sha256(inline.encode()).digest()).decode()
        scripts.append(f"'sha256-{digest}'")
    sheets = re.findall(r'<link type="text/css" rel="stylesheet" href="([^"]+)"', page)
    icons = re.findall(r'<link rel="shortcut icon" href="([^"]+)"', page)
    return (
        f"default-src 'none'; script-src {' '.join(scripts)}; style-src {' '.join(sheets)} 'unsafe-inline'; "
        f"img-src {' '.join(icons)} data:; connect-src 'self'; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )
