"""Names of measurements and fits: given by who sends them, shown in lists, and the names of the files they become.

A name is no part of an identity: the same measurement or fit sent with another name is renamed.
"""

import re
from collections.abc import Sequence
from urllib.parse import quote, unquote

from dsbrdf.errors import InvalidArgumentError

MAX_LENGTH = 100
_SUFFIX = ".binary"
_EXTENDED = re.compile(r";\s*filename\*\s*=\s*utf-8''([^;\s]*)", re.IGNORECASE)
_QUOTED = re.compile(r';\s*filename\s*=\s*"((?:[^"\\]|\\.)*)"', re.IGNORECASE)
_PLAIN = re.compile(r';\s*filename\s*=\s*([^";\s]+)', re.IGNORECASE)


def check_name(text: str) -> str:
    """Return a name; raise InvalidArgumentError if it cannot be the name of a file on any system."""
    if not 0 < len(text) <= MAX_LENGTH or not text.isprintable() or text.strip() != text or re.search(r"[/\\]", text):
        raise InvalidArgumentError(
            f"A name has 1 to {MAX_LENGTH} printable characters without slashes, and no space at its ends; "
            f"{text[:60]!r} is none."
        )
    return text


def given_name(given: Sequence[str], content_disposition: str) -> str | None:
    """Return the name that a query gives, or the file name of a ``Content-Disposition``; None without either.

    Raises InvalidArgumentError if it is no name, or the query has two.
    """
    if len(given) > 1:
        raise InvalidArgumentError("The name is given more than once; give it once.")
    if given:
        return check_name(given[0])
    file_name = _file_name(content_disposition)
    if file_name is None:
        return None
    return check_name(re.split(r"[/\\]", file_name)[-1].removesuffix(_SUFFIX))  # a folder is the sender's matter


def content_disposition(file_name: str) -> str:
    """Return the header with which a file is saved under a name (RFC 6266)."""
    encoded = quote(file_name, safe="")
    plain = f'filename="{file_name}"' if encoded == file_name else f"filename*=UTF-8''{encoded}"
    return f"attachment; {plain}"


def _file_name(header: str) -> str | None:
    """Return the file name of a ``Content-Disposition`` header (RFC 6266); the extended form goes first."""
    if found := _EXTENDED.search(header):
        return unquote(found[1])
    if found := _QUOTED.search(header):
        return _as_utf_8(re.sub(r"\\(.)", r"\1", found[1]))
    found = _PLAIN.search(header)
    return found and _as_utf_8(found[1])


def _as_utf_8(text: str) -> str:
    """Return what is probably meant: many programs send UTF-8, though HTTP takes it for Latin-1."""
    try:
        return text.encode("latin-1").decode()
    except UnicodeDecodeError:
        return text
