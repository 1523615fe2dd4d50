"""Send the files of the web page, and of the page that shows the OpenAPI document; these files need no API key.

The pages load nothing from the internet. Addresses in the pages are relative, so that the pages work behind a proxy
that adds a prefix.
"""

import gzip
import re
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from importlib.resources.abc import Traversable

from starlette.requests import Request
from starlette.responses import Response

from .messages import tagged_reply

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""Content security policy of pages: they load their scripts and styles, answers of the service, and made pictures."""
# All addresses of this form show the same page, which itself reports an unknown fit or measurement.
_PAGE_PATHS = re.compile(r"/|/compare|/(fits|measurements)/[0-9A-Za-z_-]{1,100}")
_TYPES = {"js": "text/javascript", "css": "text/css", "html": "text/html; charset=utf-8"}


@dataclass(frozen=True)
class StaticFile:
    """Hold the bytes of a file that is sent, and its media type."""

    content: bytes
    media_type: str

    @cached_property
    def compressed(self) -> bytes:
        """The content as gzip."""
        return gzip.compress(self.content, mtime=0)

    def reply(self, request: Request) -> Response:
        """Return the file, or 304 if the client has it."""
        headers = {"Vary": "Accept-Encoding"}
        if self.media_type.startswith("text/html"):
            headers["Content-Security-Policy"] = POLICY
        content = self.content
        if "gzip" in request.headers.get("accept-encoding", ""):
            content, headers["Content-Encoding"] = self.compressed, "gzip"
        return tagged_reply(request, content, self.media_type, headers)


def _read(file: Traversable) -> StaticFile:
    return StaticFile(file.read_bytes(), _TYPES[file.name.rpartition(".")[2]])


_OURS = files(__package__) / "page"
_SWAGGER_UI = files("fastapi_offline") / "static"
_PAGE = _read(_OURS / "index.html")
_PAGE_BELOW = StaticFile(_PAGE.content.replace(b'="./', b'="../'), _PAGE.media_type)
STATIC_FILES = {f"/docs/{name}": _read(_SWAGGER_UI / name) for name in ("swagger-ui-bundle.js", "swagger-ui.css")}
STATIC_FILES |= {f"/page/{file.name}": _read(file) for file in _OURS.iterdir() if file.name.endswith((".js", ".css"))}
STATIC_FILES["/docs"] = _read(_OURS / "docs.html")
"""All static files but the page, by path."""


def file_at(path: str) -> StaticFile | None:
    """Return the static file for a path; relative addresses in the page fit the depth of the path."""
    if _PAGE_PATHS.fullmatch(path):
        return _PAGE_BELOW if path.count("/") > 1 else _PAGE
    return STATIC_FILES.get(path)


def is_open(path: str) -> bool:
    """Return whether a path needs no key: a static file, or the OpenAPI document."""
    return not path.startswith("/v1/") and (path == "/openapi.json" or file_at(path) is not None)
