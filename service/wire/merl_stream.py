"""A model as a MERL table that is computed while it is sent, so that a client that does not read costs no memory."""

import os
from collections.abc import AsyncIterator
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from starlette.concurrency import run_in_threadpool

from dsbrdf import DSBRDF
from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.merl_validation import HEADER, NODES, SCALE

_ROWS = 1  # angles theta_half at a time: what is kept for a client that does not read
_PIECE = _ROWS * THETA_DIFF.size * PHI_DIFF.size * 8  # bytes of them in one channel
_QUARTER = PHI_DIFF.size // 2 + 1  # the model is the same at phi_diff and pi - phi_diff


async def merl_parts(model: DSBRDF, folder: Path) -> AsyncIterator[bytes]:
    """Yield the bytes of the table, those of `dsbrdf.output.export.merl_table`.

    The channels are in the file one after the other and computed together: green and blue wait in a temporary file in
    `folder` until red has been sent.
    """
    yield HEADER
    with TemporaryFile(dir=folder, buffering=0) as file:
        for offset in range(0, 8 * NODES, _PIECE):
            yield await run_in_threadpool(_compute, model, file.fileno(), offset)
        for offset in range(0, (len(SCALE) - 1) * 8 * NODES, _PIECE):
            yield await run_in_threadpool(os.pread, file.fileno(), _PIECE, offset)


def _compute(model: DSBRDF, descriptor: int, offset: int) -> bytes:
    """Return the piece of red at an offset in its channel; write those of green and blue to the file."""
    first = offset // _PIECE * _ROWS
    grid = model.evaluate_grid(THETA_HALF[first : first + _ROWS], THETA_DIFF, PHI_DIFF[:_QUARTER])
    quarter = np.stack(list(grid), axis=1) / SCALE[:, None, None, None]
    red, *others = (part.tobytes() for part in np.concatenate([quarter, quarter[..., -2:0:-1]], axis=-1).astype("<f8"))
    for channel, part in enumerate(others):
        os.pwrite(descriptor, part, channel * 8 * NODES + offset)
    return red
