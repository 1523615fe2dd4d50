"""HTML pages: rendered from the templates of ``service/page``, with what else a browser loads for them.

Nothing is loaded from elsewhere and nothing in a page itself runs.  Addresses in a page begin with ``root``, a relative
one, so that they hold behind a proxy that adds a prefix.
"""

import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from starlette.responses import HTMLResponse

import dsbrdf

STATIC_FILES = {
    "page.css": "text/css",
    "upload.js": "text/javascript",
    "progress.js": "text/javascript",
    "list.js": "text/javascript",
    "fit.js": "text/javascript",
    "compare.js": "text/javascript",
    "sphere.js": "text/javascript",
    "profiles.js": "text/javascript",
    "polar.js": "text/javascript",
    "icon.svg": "image/svg+xml",
}
"""Media types of the files beside the templates that pages load."""
PAGE_PATHS = re.compile(r"/|/compare|/fits/[0-9a-f]{32}")
"""Paths of the pages."""
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
)
_templates = Environment(
    loader=PackageLoader("service", "page"),
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


def sign_in_page(path: str, fault: str, headers: Mapping[str, str] | None = None) -> HTMLResponse:
    """Return the page that asks for a key, and leads to the page at `path` then."""
    return render("sign_in.html", path, 401, headers, fault=fault, wanted=path, signed_in=False)


def static_file(name: str) -> bytes:
    """Return one of `STATIC_FILES`."""
    return (files("service") / "page" / name).read_bytes()
