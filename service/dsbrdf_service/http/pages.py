"""HTML pages: rendered from the templates of ``page/``, with what else a browser loads for them.

Nothing is loaded from elsewhere, so they work without the internet, and no script stands in a page itself. Addresses
in a page are relative, those of a template begin with ``root``, so that they hold behind a proxy that adds a prefix.
"""

import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from starlette.responses import HTMLResponse

import dsbrdf

_PACKAGE = __name__.partition(".")[0]
_OURS = files(_PACKAGE) / "page"
_SWAGGER_UI = files("fastapi_offline") / "static"
_TYPES = {"js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
_served = {f"/docs/{name}": _SWAGGER_UI / name for name in ("swagger-ui-bundle.js", "swagger-ui.css")}
_served |= {f"/page/{file.name}": file for file in _OURS.iterdir() if file.name.rpartition(".")[2] in _TYPES}
STATIC_FILES = {path: (file, _TYPES[path.rpartition(".")[2]]) for path, file in _served.items()}
STATIC_FILES["/docs"] = _OURS / "docs.html", "text/html; charset=utf-8"
"""Path -> file and media type: the page of the OpenAPI document, and what this one and the other pages load."""
PAGE_PATHS = re.compile(r"/|/compare|/fits/[0-9a-f]{32}")
"""Paths of the pages."""
_SOURCES = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'"
)
_POLICY = f"{_SOURCES}; form-action 'self'"
POLICY_WITHOUT_FORMS = f"{_SOURCES}; form-action 'none'"
_templates = Environment(
    loader=PackageLoader(_PACKAGE, "page"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def render(
    template: str, path: str, status: int = 200, headers: Mapping[str, str] | None = None, **values: Any
) -> HTMLResponse:
    """Return a page at `path`; the template gets the `values`."""
    root = "../" * (path.count("/") - 1) or "./"
    text = _templates.get_template(template).render(root=root, version=dsbrdf.__version__, **values)
    return HTMLResponse(text, status, {"Content-Security-Policy": _POLICY, **(headers or {})})


def sign_in_page(path: str, fault: str, headers: Mapping[str, str] | None = None, status: int = 401) -> HTMLResponse:
    """Return the page that asks for a key, and leads to the page at `path` then."""
    return render("sign_in.html", path, status, headers, fault=fault, wanted=path, signed_in=False)
