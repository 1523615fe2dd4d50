"""Imported once by the server from which worker processes are forked, so that every worker finds its imports done."""

import atexit
import os
from contextlib import suppress
from multiprocessing import forkserver
from pathlib import Path

from dsbrdf.process_settings import ONE_BLAS_THREAD

os.environ.update(ONE_BLAS_THREAD)  # NumPy reads it when it is imported.

import dsbrdf.engines.local  # noqa: F401 (what workers run)
from dsbrdf.data.grid import nodes_above_horizon

nodes_above_horizon()  # the result is cached, and the workers share its memory


@atexit.register
def _remove_socket() -> None:
    """Remove the server's socket and its folder: the process that made them cannot do so after a kill -9."""
    with suppress(OSError):
        socket = Path(forkserver._forkserver._forkserver_address)  # type: ignore[attr-defined]
        socket.unlink()
        socket.parent.rmdir()
