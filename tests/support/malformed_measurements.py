"""Files that are not acceptable measurements, each made from one that is."""

import base64
import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable

import numpy as np

from dsbrdf.data.merl_validation import FILE_SIZE
from tests.support.merl_files import HEADER, NODES, filled, header, with_value
from tests.support.points import npy

CHANNEL = 8 * NODES

Make = Callable[[bytes], bytes]


def with_bits(data: bytes, bits: int, position: int = 12 + 8 * 700_000) -> bytes:
    return data[:position] + struct.pack("<Q", bits) + data[position + 8 :]


def few_valid(share: float) -> bytes:
    values = np.full((3, NODES), -1.0)
    values[:, : int(share * NODES)] = 0.5
    return HEADER + values.tobytes()


def values_of(data: bytes) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.frombuffer(data, "<f8", offset=12)


def zipped(data: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("paint.binary", data[:100_000])
    return buffer.getvalue()


def form(data: bytes) -> bytes:
    head = b'--x\r\nContent-Disposition: form-data; name="file"; filename="paint.binary"\r\n\r\n'
    return head + data + b"\r\n--x--\r\n"


LENGTHS: dict[str, Make] = {
    "empty": lambda _: b"",
    **{f"{n} bytes": (lambda data, n=n: data[:n]) for n in (1, 11, 12, 13, 20)},  # type: ignore[misc]
    "one channel": lambda data: data[: 12 + CHANNEL],
    "half": lambda data: data[: FILE_SIZE // 2],
    "one byte less": lambda data: data[:-1],
    "one value less": lambda data: data[:-8],
    "one byte more": lambda data: data + b"\0",
    "one value more": lambda data: data + data[-8:],
    "without a header": lambda data: data[12:],
    "two headers": lambda data: HEADER + data,
}
DIMENSIONS: dict[str, Make] = {
    **{
        f"dimensions {dimensions}": (lambda data, dimensions=dimensions: header(*dimensions) + data[12:100_000])  # type: ignore[misc]
        for dimensions in [
            (89, 90, 180), (90, 91, 180), (90, 90, 179), (90, 90, 360), (180, 90, 90), (1, 1, NODES), (-90, -90, 180),
            (0, 0, 0), (-(2**31), 90, 180), (2**31 - 1, 2**31 - 1, 2**31 - 1), (1_610_612_826, 90, 180),
        ]
    },
    "big-endian": lambda data: header(90, 90, 180, order=">") + data[12:],
    "big-endian throughout": lambda data: header(90, 90, 180, order=">") + values_of(data).astype(">f8").tobytes(),
    "dimensions of 64 bits": lambda data: struct.pack("<3q", 90, 90, 180) + data[12:],
}  # fmt: skip
VALUES: dict[str, Make] = {
    "nan": lambda data: with_value(data, np.nan),
    "nan in the last value": lambda data: with_value(data, np.nan, FILE_SIZE - 8),
    "a signalling nan": lambda data: with_bits(data, 0x7FF0000000000001),
    "infinity": lambda data: with_value(data, np.inf),
    "negative infinity": lambda data: with_value(data, -np.inf),
    "all nan": lambda _: filled(np.nan),
    "too large": lambda _: filled(1e12),
    "one much too large": lambda data: with_value(data, 1.7e308),
    "all zero": lambda _: filled(0.0),
    "no valid node": lambda _: filled(-1.0),
    "no valid node in blue": lambda data: data[: 12 + 2 * CHANNEL] + np.full(NODES, -1.0).tobytes(),
    "hardly any valid node": lambda _: few_valid(0.003),
    "values big-endian": lambda data: HEADER + values_of(data).astype(">f8").tobytes(),
    "float32": lambda data: HEADER + values_of(data).astype("<f4").tobytes(),
    "all bits set": lambda data: HEADER + b"\xff" * (FILE_SIZE - 12),
}
OTHER_FILES: dict[str, Make] = {
    "text": lambda _: b"this is not a measurement\n" * 1000,
    "json": lambda _: json.dumps({"measurement": [1.0] * 1000}).encode(),
    "a form": form,
    "base64": lambda data: base64.b64encode(data),
    "a byte order mark": lambda data: b"\xef\xbb\xbf" + data,
    "as utf-8": lambda data: data[:2_000_000].decode("latin-1").encode(),
    "npy": lambda data: npy(values_of(data).reshape(3, 90, 90, 180)),
    "zip": zipped,
    "gzip without its header": lambda data: gzip.compress(data[:1_000_000], 1),
    "png": lambda _: b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(1000),
    "pickle": lambda _: b"cos\nsystem\n(S'true'\ntR.",
}
MALFORMED: dict[str, Make] = LENGTHS | DIMENSIONS | VALUES | OTHER_FILES
