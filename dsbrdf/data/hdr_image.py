"""Pictures of radiance: Radiance ``.hdr`` files, and OpenEXR ``.exr`` files with the extra ``exr``.

A Radiance file (Ward 1991, "Real pixels") is a header of text lines, an empty line, ``-Y height +X width``, and rows of
pixels of four bytes: three mantissas and one exponent. In a row that begins with 2, 2 and its length, each of the four
is stored on its own: a byte n above 128 and one to be repeated n - 128 times, or a byte n and n others.
"""

import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dsbrdf.arrays import Array
from dsbrdf.data.files import known_kind
from dsbrdf.errors import ImageFormatError
from dsbrdf.extras import require

SUFFIXES = (".hdr", ".exr")
"""Of pictures of radiance."""
_MOST_PIXELS = 1 << 26
_RESOLUTION = re.compile(rb"-Y ([0-9]{1,6}) \+X ([0-9]{1,6})\n")


def read_hdr_image(path: str | os.PathLike[str]) -> Array:
    """Read a ``.hdr`` or ``.exr`` file as linear RGB of shape (height, width, 3), the first row at the top.

    Raises ImageFormatError if the file is none, is damaged or cut off, or has a value that is not finite, and
    MissingExtraError for an OpenEXR file if the extra ``exr`` is not installed.
    """
    source = Path(path)
    if source.suffix.lower() not in SUFFIXES:
        raise ImageFormatError(f"A picture of radiance ends in {' or '.join(SUFFIXES)}, unlike {source.name!r}.")
    data = source.read_bytes()
    if data.startswith(b"v/1\x01"):
        pixels = _read_exr(source)
    elif data.startswith(b"#?"):
        pixels = _parse_radiance(data)
    else:
        kind = known_kind(data[:16])
        said = "neither a Radiance nor an OpenEXR picture" if kind is None else kind
        raise ImageFormatError(f"The file is {said}; a picture of radiance is a Radiance .hdr or an OpenEXR .exr file.")
    if not np.isfinite(pixels).all():
        raise ImageFormatError("The picture has values that are NaN or infinite; radiance is finite.")
    return np.maximum(pixels, 0.0)


def _read_exr(path: Path) -> Array:
    require("exr", "OpenEXR", purpose="OpenEXR pictures")
    import OpenEXR  # type: ignore[import-not-found]  # ships no types

    try:
        with OpenEXR.File(str(path)) as file:
            channels = {name: np.asarray(channel.pixels) for name, channel in file.channels().items()}
    except Exception:  # the library raises several kinds, ill-documented
        raise ImageFormatError("The OpenEXR picture is damaged or cut off.") from None
    for name in ("RGB", "RGBA"):
        if name in channels:
            return channels[name][..., :3].astype(np.float64)
    raise ImageFormatError(f"The OpenEXR picture has the channels {', '.join(sorted(channels))}, not R, G and B.")


def _parse_radiance(data: bytes) -> Array:
    head, _, rest = data.partition(b"\n\n")
    match = _RESOLUTION.match(rest)
    if match is None:
        raise ImageFormatError(
            "The Radiance picture has no line '-Y height +X width' after its header: it is damaged or turned."
        )
    if (layout := re.search(rb"^FORMAT=(.*)$", head, re.MULTILINE)) and layout[1].strip() != b"32-bit_rle_rgbe":
        raise ImageFormatError("The Radiance picture is not in RGB: its FORMAT must be 32-bit_rle_rgbe.")
    height, width = int(match[1]), int(match[2])
    if not 0 < height * width <= _MOST_PIXELS:
        raise ImageFormatError(f"The picture has {width} x {height} pixels; it must have some, at most {_MOST_PIXELS}.")
    try:
        rgbe = _radiance_rows(memoryview(rest)[match.end() :], height, width)
    except (IndexError, ValueError):
        raise ImageFormatError("The Radiance picture is damaged or cut off: its rows are incomplete.") from None
    scale = np.where(rgbe[..., 3:] > 0, np.ldexp(1.0, rgbe[..., 3:].astype(np.int32) - 136), 0.0)
    exposure = np.prod([float(value) for value in re.findall(rb"^EXPOSURE= *([0-9.eE+-]+) *$", head, re.MULTILINE)])
    return np.asarray((rgbe[..., :3] + 0.5) * scale / exposure)


def _radiance_rows(data: memoryview, height: int, width: int) -> NDArray[np.uint8]:
    """Mantissas and exponents, shape (height, width, 4); an IndexError or ValueError if there are too few bytes."""
    if len(data) < 4 or data[0] != 2 or data[1] != 2 or data[2] * 256 + data[3] != width:
        return np.frombuffer(data, np.uint8, height * width * 4).reshape(height, width, 4)
    rows = np.empty((height, 4, width), np.uint8)
    at = 0
    for row in rows:
        if data[at] != 2 or data[at + 1] != 2 or data[at + 2] * 256 + data[at + 3] != width:
            raise ValueError
        at += 4
        for plane in row:
            done = 0
            while done < width:
                count = data[at]
                if count > 128:
                    count -= 128
                    plane[done : done + count], used = data[at + 1], 2
                else:
                    plane[done : done + count] = np.frombuffer(data, np.uint8, count, at + 1)
                    used = 1 + count
                if not 0 < count <= width - done:
                    raise ValueError
                done, at = done + count, at + used
    return np.ascontiguousarray(rows.transpose(0, 2, 1))
