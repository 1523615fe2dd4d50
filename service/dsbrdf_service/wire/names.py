"""Names of measurements and fits: given by who sends them, shown in lists, and the names of the files they become.

A name is no part of an identity: the same measurement or fit sent with another name is renamed.
"""

import re
from contextlib import suppress
from email.message import Message
from email.utils import collapse_rfc2231_value
from urllib.parse import quote

from dsbrdf.errors import InvalidArgumentError

MAX_LENGTH = 100
_SUFFIX = ".binary"


def check_name(text: str) -> str:
    """Return a name; raise InvalidArgumentError if it cannot be the name of a file on any system."""
    if not 0 < len(text) <= MAX_LENGTH or not text.isprintable() or text.strip() != text or re.search(r"[/\\]", text):
        raise InvalidArgumentError(
            f"A name has 1 to {MAX_LENGTH} printable characters without slashes, and no space at its ends; "
            f"{text[:60]!r} is none."
        )
    return text


def given_name(given: str | None, content_disposition: str) -> str | None:
    """Return the name in a query, or the file name in a ``Content-Disposition`` (RFC 6266); None without either.

    Raises InvalidArgumentError if it is no name.
    """
    if given is not None:
        return check_name(given)
    message = Message()
    message["Content-Disposition"] = content_disposition
    parameters = {name.lower(): value for name, value in message.get_params([], "content-disposition")}
    if "filename" not in parameters:
        return None
    name = collapse_rfc2231_value(parameters["filename"])  # the extended form comes last, so it is the one that is kept
    with suppress(UnicodeError):
        name = name.encode("latin-1").decode()  # many programs send UTF-8, though HTTP takes it for Latin-1
    return check_name(re.split(r"[/\\]", name)[-1].removesuffix(_SUFFIX))  # a folder is the sender's matter


def content_disposition(file_name: str) -> str:
    """Return the header with which a file is saved under a name (RFC 6266)."""
    encoded = quote(file_name, safe="")
    plain = f'filename="{file_name}"' if encoded == file_name else f"filename*=UTF-8''{encoded}"
    return f"attachment; {plain}"
