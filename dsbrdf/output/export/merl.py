"""A model or a component as a MERL ``.binary`` table, part by part, for those who have little memory."""

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from dsbrdf.data.grid import PHI_DIFF, QUARTER, THETA_DIFF, THETA_HALF
from dsbrdf.data.merl_validation import HEADER, NODES, SCALE
from dsbrdf.model.reflectance import ReflectanceModel


def merl_parts(model: ReflectanceModel, folder: Path) -> Iterator[bytes]:
    """Yield the bytes of a MERL file with the values of a model at every node, computed as they are asked for.

    The channels are in the file one after the other and computed together, an angle theta_half at a time: green and
    blue wait in a temporary file without a name, in `folder`, until red has been taken.
    """
    yield HEADER
    size = 8 * NODES // THETA_HALF.size  # bytes of an angle in one channel
    with TemporaryFile(dir=folder, buffering=0) as file:
        for row in range(THETA_HALF.size):
            (values,) = model.evaluate_grid(THETA_HALF[row : row + 1], THETA_DIFF, PHI_DIFF[:QUARTER])
            quarter = values / SCALE[:, None, None]
            red, *others = np.concatenate([quarter, quarter[..., -2:0:-1]], axis=-1).astype("<f8")
            for channel, part in enumerate(others):
                os.pwrite(file.fileno(), part.tobytes(), 8 * NODES * channel + size * row)
            yield red.tobytes()
        for offset in range(0, (len(SCALE) - 1) * 8 * NODES, size):
            yield os.pread(file.fileno(), size, offset)
