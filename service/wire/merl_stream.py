"""A model as a MERL table that is computed while it is sent, so that a client that does not read costs no memory."""

from collections.abc import AsyncIterator

import numpy as np
from starlette.concurrency import run_in_threadpool

from dsbrdf import DSBRDF
from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.merl_validation import HEADER, SCALE

_ROWS = 3  # angles theta_half at a time, of 130 kB each
_QUARTER = PHI_DIFF.size // 2 + 1  # the model is the same at phi_diff and pi - phi_diff


async def merl_parts(model: DSBRDF) -> AsyncIterator[bytes]:
    """Yield the bytes of the table, those of `dsbrdf.output.export.merl_table`.

    The channels are in the file one after the other; all three are computed for each, which takes three times as long
    as to keep them.
    """
    yield HEADER
    for channel in range(len(SCALE)):
        for start in range(0, THETA_HALF.size, _ROWS):
            yield await run_in_threadpool(_rows, model, channel, start)


def _rows(model: DSBRDF, channel: int, start: int) -> bytes:
    grid = model.evaluate_grid(THETA_HALF[start : start + _ROWS], THETA_DIFF, PHI_DIFF[:_QUARTER])
    quarter = np.stack([values[channel] for values in grid]) / SCALE[channel]
    return np.concatenate([quarter, quarter[..., -2:0:-1]], axis=-1).astype("<f8").tobytes()
