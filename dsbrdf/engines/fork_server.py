"""Start the fork server, a process with the library loaded from which worker processes are forked.

Worker processes share neither memory nor connections with this process. On systems without fork servers, each worker is
a new interpreter, which takes longer to start.
"""

import multiprocessing
import signal
import sys
import threading
from multiprocessing import resource_tracker, util
from pathlib import Path
from typing import Any

# Every worker imports the modules among these that this process has imported, so the server imports them once.
_IMPORTED_BY_WORKERS = {"distributed", "dsbrdf_service.compute.steps"}
START_LOCK = threading.Lock()
"""Held while a process starts or its exit code is collected, because each start collects exit codes of others too."""


def context() -> Any:
    """Return the context of `multiprocessing` that starts worker processes."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    forking = multiprocessing.get_context("forkserver")
    imported_here = _IMPORTED_BY_WORKERS & sys.modules.keys()
    forking.set_forkserver_preload(["dsbrdf.engines.fork_server_preload", *sorted(imported_here)])
    return forking


def start_fork_server() -> None:
    """Start the fork server, unless it runs or the system has none; Ctrl-C does not reach it or its workers.

    Raises OSError if the server cannot be started, or if its socket has been removed.
    """
    if context().get_start_method() != "forkserver":
        return
    from multiprocessing import forkserver

    with START_LOCK:
        resource_tracker.ensure_running()  # If the server started the tracker, interrupts would be unblocked.
        signals = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        if not any(Path(util.get_temp_dir()).glob("listener-*")):
            raise FileNotFoundError("no process can be started: a socket has been removed; start this program again")
