"""Import the modules that workers use once, in the fork server, so that workers start with loaded modules."""

import atexit
import os
from contextlib import suppress
from multiprocessing import forkserver
from pathlib import Path

from dsbrdf.process_settings import ONE_BLAS_THREAD

os.environ.update(ONE_BLAS_THREAD)  # The variables are set before the import of NumPy, which reads them.

import dsbrdf.engines.local  # noqa: F401 (workers run its functions)
from dsbrdf.data.geometry import nodes_above_horizon

nodes_above_horizon()  # This call fills a cache in memory that all forked workers share.


@atexit.register
def _remove_socket() -> None:
    """Remove the server's socket and the folder of the socket, because a parent process ended by kill -9 cannot."""
    with suppress(OSError):
        socket = Path(forkserver._forkserver._forkserver_address)  # type: ignore[attr-defined]
        socket.unlink()
        socket.parent.rmdir()
