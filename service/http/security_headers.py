"""Headers of every answer that tell browsers and caches what they must not do with it.

Answers are documents, not pages: nothing in them may run, be framed, be read by a page of another site, or be shown
to someone who has not asked with the same key. The page of the documentation brings a policy of its own.
"""

from collections.abc import Iterable

_ALWAYS = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"vary", b"Authorization"),
)
_UNLESS_GIVEN = (
    (b"content-security-policy", b"default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"),
    # Kept by the client that has asked, for its If-None-Match, and not used again without asking.
    (b"cache-control", b"private, no-cache"),
)


def secured(headers: Iterable[tuple[bytes, bytes]]) -> list[tuple[bytes, bytes]]:
    """Return the headers of an answer with the ones that protect it."""
    every = [*headers, *_ALWAYS]
    given = {name for name, _ in every}
    every += [header for header in _UNLESS_GIVEN if header[0] not in given]
    return every
