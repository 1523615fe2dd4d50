"""The measurement that most tests are about, and MERL files to damage: their layout, and changed copies of a file."""

import struct
from functools import cache

from dsbrdf import Measurement
from dsbrdf.data import synthetic_measurement

NODES = 90 * 90 * 180
HEADER = struct.pack("<3i", 90, 90, 180)
BELOW = (80, 80, 0)  # theta_half + theta_diff = 151 degrees: below the horizon
ABOVE = (10, 20, 30)


@cache
def glossy_plastic() -> Measurement:
    """A glossy coloured plastic with 2 % noise."""
    return synthetic_measurement(noise=0.02, seed=1, name="plastic")


def header(*dimensions: int, order: str = "<") -> bytes:
    return struct.pack(f"{order}3i", *dimensions)


def position(channel: int, node: tuple[int, int, int]) -> int:
    """Byte offset of a value, by the definition of the format."""
    half, diff, phi = node
    return 12 + 8 * (phi + 180 * (diff + 90 * (half + 90 * channel)))


def with_values(data: bytes, changes: dict[tuple[int, tuple[int, int, int]], float]) -> bytes:
    changed = bytearray(data)
    for (channel, node), value in changes.items():
        struct.pack_into("<d", changed, position(channel, node), value)
    return bytes(changed)


def with_value(data: bytes, value: float, position: int = 12 + 8 * 700_000) -> bytes:
    return data[:position] + struct.pack("<d", value) + data[position + 8 :]
