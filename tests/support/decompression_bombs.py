"""Small or endless bodies that would cost a careless server much: memory, disk or time."""

import gzip
import json
import zlib
from collections.abc import Callable, Iterator
from itertools import repeat
from typing import Any

from tests.support.merl_files import HEADER

MEASUREMENT = "application/octet-stream"
JSON = "application/json"
NPY = "application/x-npy"

_STORED_BLOCK = b"\0\0\0\xff\xff"  # of a gzip member that goes on, without content
_GZIP_HEAD = b"\x1f\x8b\x08%c\0\0\0\0\0\xff"


def packed(packer: Any, *parts: bytes) -> bytes:
    """Return parts compressed one after the other."""
    return b"".join([*map(packer.compress, parts), packer.flush()])


def gzip_packer() -> Any:
    return zlib.compressobj(1, wbits=31)


def zeros(megabytes: int) -> Iterator[bytes]:
    return repeat(bytes(1 << 20), megabytes)


def nested(levels: int) -> bytes:
    body = packed(gzip_packer(), HEADER, *zeros(64))
    for _ in range(levels):
        body = gzip.compress(body)
    return body


# name -> (type of the body, its encoding, what makes it)
BOMBS: dict[str, tuple[str, str, Callable[[], bytes]]] = {
    "gzip zeros": (MEASUREMENT, "gzip", lambda: packed(gzip_packer(), HEADER, *zeros(300))),
    "gzip in gzip, and says so": (MEASUREMENT, "gzip, gzip, gzip", lambda: nested(3)),
    "endless empty gzip blocks": (MEASUREMENT, "gzip", lambda: _GZIP_HEAD % 0 + _STORED_BLOCK * 8_000_000),
    "endless gzip name": (MEASUREMENT, "gzip", lambda: _GZIP_HEAD % 8 + b"a" * 40_000_000),
    "deep JSON of points": (JSON, "gzip", lambda: gzip.compress(b"[" * 30_000_000, 1)),
    "many JSON numbers": (
        JSON,
        "gzip",
        lambda: packed(gzip_packer(), b'{"theta_half_deg": [', *repeat(b"0," * (1 << 20), 100)),
    ),
    "endless empty gzip blocks of points": (NPY, "gzip", lambda: _GZIP_HEAD % 0 + _STORED_BLOCK * 4_000_000),
    "many JSON names": (JSON, "identity", lambda: json.dumps({f"n{i}": i for i in range(4000)}).encode()),
    "a long JSON number": (JSON, "identity", lambda: b'{"theta_half_deg": [' + b"9" * 1_000_000 + b"]}"),
}
