"""Check the names of measurements and fits, which clients choose; lists and exported files have these names.

A name does not identify a measurement: a measurement that is sent again under another name is renamed.
"""

import re
from contextlib import suppress
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote_to_bytes

from dsbrdf.errors import InvalidArgumentError

if TYPE_CHECKING:  # The Python client checks names too, and must not import Starlette, which it does not need.
    from starlette.requests import Request

MAX_LENGTH = 100
_SUFFIX = ".binary"
_MAX_HEADER_LENGTH = 1024  # [characters] A longer Content-Disposition is refused.
_PARAMETER = re.compile(r';\s*([^\s=;"]+)\s*=\s*("(?:[^"\\]|\\.)*"|[^\s;"]+)\s*')


def check_name(text: str) -> str:
    """Return a name; raise InvalidArgumentError if it cannot be the name of a file on any system."""
    if not 0 < len(text) <= MAX_LENGTH or not text.isprintable() or text.strip() != text or re.search(r"[/\\]", text):
        raise InvalidArgumentError(
            f"{text[:60]!r} is not a valid name: a name has 1 to {MAX_LENGTH} printable characters, no slash "
            "and no space at its ends."
        )
    return text


def given_name(request: "Request") -> str | None:
    """Return the name that a request gives to its upload or fit, if any.

    The name is the parameter `name` of the query, or the file name in ``Content-Disposition`` (RFC 6266).

    Raises InvalidArgumentError if the name is not valid.
    """
    if "name" in request.query_params:
        return check_name(request.query_params["name"])
    header = request.headers.get("content-disposition")
    name = _file_name(header) if header else None
    # The folder in a file name is removed, because it means nothing to the service.
    return None if name is None else check_name(re.split(r"[/\\]", name)[-1].removesuffix(_SUFFIX))


def _file_name(header: str) -> str | None:
    """Return the file name in a ``Content-Disposition``, preferably ``filename*`` (RFC 8187)."""
    if len(header) > _MAX_HEADER_LENGTH:
        raise InvalidArgumentError(f"A Content-Disposition has at most {_MAX_HEADER_LENGTH} characters.")
    found: dict[str, str] = {}
    place = header.find(";")
    while place >= 0 and (parameter := _PARAMETER.match(header, place)):
        found.setdefault(parameter[1].lower(), parameter[2])
        place = parameter.end()
    charset, _, rest = found.get("filename*", "").partition("'")
    with suppress(UnicodeError):
        if charset.lower() in ("utf-8", "iso-8859-1"):
            return unquote_to_bytes(rest.partition("'")[2]).decode(charset)
    name = found.get("filename")
    if name is not None:
        name = re.sub(r"\\(.)", r"\1", name[1:-1]) if name.startswith('"') else name
        with suppress(UnicodeError):
            return name.encode("latin-1").decode()  # Many programs send UTF-8, although headers are decoded as Latin-1.
    return name


def content_disposition(file_name: str) -> str:
    """Return the ``Content-Disposition`` that saves a file under a name (RFC 6266)."""
    encoded = quote(file_name, safe="")
    plain = f'filename="{file_name}"' if encoded == file_name else f"filename*=UTF-8''{encoded}"
    return f"attachment; {plain}"
