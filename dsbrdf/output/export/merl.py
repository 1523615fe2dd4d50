"""A model or a component as a MERL ``.binary`` table, for programs that read measurements: whole, or part by part."""

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from dsbrdf.data.grid import PHI_DIFF, QUARTER, THETA_DIFF, THETA_HALF
from dsbrdf.data.merl import encode_merl
from dsbrdf.data.merl_validation import HEADER, NODES, SCALE
from dsbrdf.model.reflectance import ReflectanceModel

_ROWS = 1  # angles theta_half at a time: what a part is made of
_PIECE = _ROWS * THETA_DIFF.size * PHI_DIFF.size * 8  # bytes of them in one channel


def merl_table(model: ReflectanceModel) -> bytes:
    """Return the 34,992,012 bytes of a MERL file with the values of a model at every node.

    Raises MeasurementFormatError if a value is not finite.
    """
    return encode_merl(model.tabulate())


def merl_parts(model: ReflectanceModel, folder: Path) -> Iterator[bytes]:
    """Yield the bytes of `merl_table` in parts, each computed when it is asked for, so that little memory is needed.

    The channels are in the file one after the other and computed together: green and blue wait in a temporary file
    without a name, in `folder`, until red has been taken.
    """
    yield HEADER
    with TemporaryFile(dir=folder, buffering=0) as file:
        for offset in range(0, 8 * NODES, _PIECE):
            yield _compute(model, file.fileno(), offset)
        for offset in range(0, (len(SCALE) - 1) * 8 * NODES, _PIECE):
            yield os.pread(file.fileno(), _PIECE, offset)


def _compute(model: ReflectanceModel, descriptor: int, offset: int) -> bytes:
    """Return the piece of red at an offset in its channel; write those of green and blue to the file."""
    first = offset // _PIECE * _ROWS
    grid = model.evaluate_grid(THETA_HALF[first : first + _ROWS], THETA_DIFF, PHI_DIFF[:QUARTER])
    quarter = np.stack(list(grid), axis=1) / SCALE[:, None, None, None]
    red, *others = (part.tobytes() for part in np.concatenate([quarter, quarter[..., -2:0:-1]], axis=-1).astype("<f8"))
    for channel, part in enumerate(others):
        os.pwrite(descriptor, part, channel * 8 * NODES + offset)
    return red
