"""PNG images without further packages: 8 bits, RGB or RGB with transparency."""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

__all__ = ["encode_png"]


def encode_png(image: NDArray[np.float64]) -> bytes:
    """Return the bytes of a PNG file.

    Parameters
    ----------
    image : ndarray, shape (height, width, 3) or (height, width, 4)
        Values from 0 to 1 as a screen shows them (sRGB), clipped.

    Returns
    -------
    bytes
    """
    levels = np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
    height, width, channels = levels.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), levels.reshape(height, -1)], axis=1)  # 0: no filter
    head = struct.pack(">IIBBBBB", width, height, 8, {3: 2, 4: 6}[channels], 0, 0, 0)
    chunks = ((b"IHDR", head), (b"sRGB", b"\0"), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    parts = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
