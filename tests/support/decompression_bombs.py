"""Small or endless bodies that would cost a careless server much: memory, disk or time."""

import gzip
import json
import struct
import zlib
from collections.abc import Callable, Iterator
from itertools import repeat
from typing import Any

import zstandard

from dsbrdf.data.merl_validation import FILE_SIZE
from tests.support.merl_files import HEADER

MEASUREMENT = "application/octet-stream"
JSON = "application/json"
NPY = "application/x-npy"

_FRAME = b"\x28\xb5\x2f\xfd"  # begins a zstd frame
_RAW_BLOCK = struct.pack("<I", len(HEADER) << 3)[:3] + HEADER  # of a zstd frame that goes on
_RUN_LENGTH_BLOCK = struct.pack("<I", (1 << 17) << 3 | 1 << 1)[:3] + b"\0"  # 4 bytes that stand for 128 KiB
_STORED_BLOCK = b"\0\0\0\xff\xff"  # of a gzip member that goes on, without content
_GZIP_HEAD = b"\x1f\x8b\x08%c\0\0\0\0\0\xff"


def packed(packer: Any, *parts: bytes) -> bytes:
    """Return parts compressed one after the other."""
    return b"".join([*map(packer.compress, parts), packer.flush()])


def gzip_packer() -> Any:
    return zlib.compressobj(1, wbits=31)


def zstd_packer() -> Any:
    return zstandard.ZstdCompressor(level=1).compressobj()


def zeros(megabytes: int) -> Iterator[bytes]:
    return repeat(bytes(1 << 20), megabytes)


def empty_blocks(count: int) -> bytes:
    """One zstd frame of raw blocks without content, none of which is the last."""
    return _FRAME + b"\0\x58" + bytes(3) * count


def skippable(size: int, content: bytes) -> bytes:
    return struct.pack("<II", 0x184D2A50, size) + content


def nested(levels: int) -> bytes:
    body = packed(gzip_packer(), HEADER, *zeros(64))
    for _ in range(levels):
        body = gzip.compress(body)
    return body


# name -> (type of the body, its encoding, what makes it)
BOMBS: dict[str, tuple[str, str, Callable[[], bytes]]] = {
    "gzip zeros": (MEASUREMENT, "gzip", lambda: packed(gzip_packer(), HEADER, *zeros(300))),
    "zstd zeros": (MEASUREMENT, "zstd", lambda: packed(zstd_packer(), HEADER, *zeros(1000))),
    "zstd run-length blocks": (
        MEASUREMENT,
        "zstd",
        lambda: _FRAME + b"\0\x58" + _RAW_BLOCK + _RUN_LENGTH_BLOCK * 250_000,
    ),
    "gzip in gzip, and says so": (MEASUREMENT, "gzip, gzip, gzip", lambda: nested(3)),
    "many gzip members with content": (MEASUREMENT, "gzip", lambda: gzip.compress(HEADER) * 300_000),
    "many skippable frames": (MEASUREMENT, "zstd", lambda: skippable(0, b"") * 1_000_000),
    "one endless skippable frame": (MEASUREMENT, "zstd", lambda: skippable(2**32 - 1, bytes(40_000_000))),
    "huge window": (MEASUREMENT, "zstd", lambda: _FRAME + b"\0\xf8" + _RAW_BLOCK),
    "unknown dictionary": (MEASUREMENT, "zstd", lambda: _FRAME + b"\3\x58\xef\xbe\xad\xde" + bytes(100)),
    "huge content size": (MEASUREMENT, "zstd", lambda: _FRAME + b"\xe0" + struct.pack("<Q", 2**62) + _RAW_BLOCK),
    "endless empty zstd blocks": (MEASUREMENT, "zstd", lambda: empty_blocks(13_000_000)),
    "endless empty gzip blocks": (MEASUREMENT, "gzip", lambda: _GZIP_HEAD % 0 + _STORED_BLOCK * 8_000_000),
    "endless gzip name": (MEASUREMENT, "gzip", lambda: _GZIP_HEAD % 8 + b"a" * 40_000_000),
    "gzip members with long extra fields": (
        MEASUREMENT,
        "gzip",
        lambda: (_GZIP_HEAD % 4 + struct.pack("<H", 65535) + bytes(65535) + b"\3\0" + bytes(8)) * 500,
    ),
    "zeros behind a gzip member": (MEASUREMENT, "gzip", lambda: gzip.compress(HEADER) + bytes(30_000_000)),
    "measurement with more behind it": (
        MEASUREMENT,
        "zstd",
        lambda: packed(zstd_packer(), HEADER, *zeros(FILE_SIZE >> 20)) + packed(zstd_packer(), *zeros(300)),
    ),
    "deep JSON of points": (JSON, "gzip", lambda: gzip.compress(b"[" * 30_000_000, 1)),
    "many JSON numbers": (
        JSON,
        "gzip",
        lambda: packed(gzip_packer(), b'{"theta_half_deg": [', *repeat(b"0," * (1 << 20), 100)),
    ),
    "many JSON names": (JSON, "identity", lambda: json.dumps({f"n{i}": i for i in range(4000)}).encode()),
    "a long JSON number": (JSON, "identity", lambda: b'{"theta_half_deg": [' + b"9" * 1_000_000 + b"]}"),
    "endless empty blocks of points": (NPY, "zstd", lambda: empty_blocks(30_000_000)),
}
