"""Small or endless bodies that would cost a careless server much: memory, disk or time."""

import gzip
import json
import struct
import zlib
from collections.abc import Callable

import zstandard

from dsbrdf.data.merl_validation import FILE_SIZE
from tests.support.merl_files import HEADER

MEASUREMENT = "application/octet-stream"
JSON = "application/json"
NPY = "application/x-npy"

_ZSTD = zstandard.ZstdCompressor(level=1)
_FRAME = b"\x28\xb5\x2f\xfd"  # begins a zstd frame
_GZIP_HEAD = b"\x1f\x8b\x08%c\0\0\0\0\0\xff"


def gzip_zeros(megabytes: int, start: bytes = HEADER) -> bytes:
    """Zeros behind a header that is right, a small part of their size."""
    packer = zlib.compressobj(1, wbits=31)
    parts = [packer.compress(start)]
    parts += [packer.compress(bytes(1 << 20)) for _ in range(megabytes)]
    return b"".join(parts) + packer.flush()


def zstd_zeros(megabytes: int, start: bytes = HEADER) -> bytes:
    packer = _ZSTD.compressobj()
    parts = [packer.compress(start)]
    parts += [packer.compress(bytes(1 << 20)) for _ in range(megabytes)]
    return b"".join(parts) + packer.flush()


def run_length_blocks(count: int) -> bytes:
    """One zstd frame of blocks of 4 bytes that stand for 128 KiB each."""
    first = struct.pack("<I", len(HEADER) << 3)[:3] + HEADER
    block = struct.pack("<I", (1 << 17) << 3 | 1 << 1)[:3] + b"\0"
    return _FRAME + b"\0\x58" + first + block * count


def empty_blocks(count: int) -> bytes:
    """One zstd frame of raw blocks without content, none of which is the last."""
    return _FRAME + b"\0\x58" + bytes(3) * count


def stored_blocks(count: int) -> bytes:
    """One gzip member of stored blocks without content, none of which is the last."""
    return _GZIP_HEAD % 0 + b"\0\0\0\xff\xff" * count


def huge_window() -> bytes:
    return _FRAME + b"\0\xf8" + struct.pack("<I", len(HEADER) << 3)[:3] + HEADER


def unknown_dictionary() -> bytes:
    return _FRAME + b"\3" + b"\x58" + b"\xef\xbe\xad\xde" + bytes(100)


def huge_content_size() -> bytes:
    return _FRAME + b"\xe0" + struct.pack("<Q", 2**62) + struct.pack("<I", len(HEADER) << 3)[:3] + HEADER


def skippable(size: int, content: bytes) -> bytes:
    return struct.pack("<II", 0x184D2A50, size) + content


def nested(levels: int) -> bytes:
    body = gzip_zeros(64)
    for _ in range(levels):
        body = gzip.compress(body)
    return body


def numbers() -> bytes:
    """The JSON text of an array of very many numbers."""
    start = b'{"theta_half_deg": ['
    packer = zlib.compressobj(1, wbits=31)
    return b"".join([packer.compress(start), *(packer.compress(b"0," * (1 << 20)) for _ in range(100)), packer.flush()])


# name -> (type of the body, its encoding, what makes it)
BOMBS: dict[str, tuple[str, str, Callable[[], bytes]]] = {
    "gzip zeros": (MEASUREMENT, "gzip", lambda: gzip_zeros(300)),
    "zstd zeros": (MEASUREMENT, "zstd", lambda: zstd_zeros(1000)),
    "zstd run-length blocks": (MEASUREMENT, "zstd", lambda: run_length_blocks(250_000)),
    "gzip in gzip, and says so": (MEASUREMENT, "gzip, gzip, gzip", lambda: nested(3)),
    "many gzip members with content": (MEASUREMENT, "gzip", lambda: gzip.compress(HEADER) * 300_000),
    "many skippable frames": (MEASUREMENT, "zstd", lambda: skippable(0, b"") * 1_000_000),
    "one endless skippable frame": (MEASUREMENT, "zstd", lambda: skippable(2**32 - 1, bytes(40_000_000))),
    "huge window": (MEASUREMENT, "zstd", huge_window),
    "unknown dictionary": (MEASUREMENT, "zstd", unknown_dictionary),
    "huge content size": (MEASUREMENT, "zstd", huge_content_size),
    "endless empty zstd blocks": (MEASUREMENT, "zstd", lambda: empty_blocks(13_000_000)),
    "endless empty gzip blocks": (MEASUREMENT, "gzip", lambda: stored_blocks(8_000_000)),
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
        lambda: zstd_zeros(FILE_SIZE >> 20) + zstd_zeros(300, b""),
    ),
    "deep JSON of points": (JSON, "gzip", lambda: gzip.compress(b"[" * 30_000_000, 1)),
    "many JSON numbers": (JSON, "gzip", numbers),
    "many JSON names": (JSON, "identity", lambda: json.dumps({f"n{i}": i for i in range(4000)}).encode()),
    "a long JSON number": (JSON, "identity", lambda: b'{"theta_half_deg": [' + b"9" * 1_000_000 + b"]}"),
    "endless empty blocks of points": (NPY, "zstd", lambda: empty_blocks(30_000_000)),
}
