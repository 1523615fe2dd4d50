"""Import all modules of workers once, in the fork server, so that workers start with them loaded."""

import atexit
import os
from contextlib import suppress
from multiprocessing import forkserver
from pathlib import Path

from dsbrdf.process_settings import ONE_BLAS_THREAD

os.environ.update(ONE_BLAS_THREAD)  # NumPy reads these variables at its import.

import dsbrdf.engines.local  # noqa: F401 (workers run its functions)
from dsbrdf.data.grid import nodes_above_horizon

nodes_above_horizon()  # The result is cached, and workers share its memory.


@atexit.register
def _remove_socket() -> None:
    """Remove the socket of the server and its folder; after kill -9, the process that made them cannot do so."""
    with suppress(OSError):
        socket = Path(forkserver._forkserver._forkserver_address)  # type: ignore[attr-defined]
        socket.unlink()
        socket.parent.rmdir()
