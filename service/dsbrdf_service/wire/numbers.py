"""Numbers in texts of clients."""

from typing import TypeVar

T = TypeVar("T")


def number_of(text: str) -> float:
    """Return the number that a text is; raise ValueError if only Python takes it for one, such as ``1_0``."""
    return float(check_plain(text))


def check_plain(text: T) -> T:
    """Return what is given; raise ValueError if it is a text that only Python takes for a number."""
    if isinstance(text, str) and ("_" in text or not text.isascii()):
        raise ValueError(f"{text[:40]!r} is no number")
    return text
