"""Start the fork server: a process that has loaded the library, and from which worker processes are forked.

A worker process shares neither memory nor connections with this process. On systems without fork servers, each worker
is a new interpreter, which takes longer to start.
"""

import multiprocessing
import signal
import sys
import threading
from multiprocessing import resource_tracker, util
from pathlib import Path
from typing import Any

# Modules that the fork server imports once for all workers, if this process has imported them too.
_IMPORTED_BY_WORKERS = {"distributed", "dsbrdf_service.compute.steps"}
START_LOCK = threading.Lock()
"""Lock for starting a process or collecting an exit code, because a start also collects other processes' exit codes."""


def context() -> Any:
    """Return the context of `multiprocessing` that starts worker processes."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    forking = multiprocessing.get_context("forkserver")
    imported_here = _IMPORTED_BY_WORKERS & sys.modules.keys()
    forking.set_forkserver_preload(["dsbrdf.engines.fork_server_preload", *sorted(imported_here)])
    return forking


def start_fork_server() -> None:
    """Start the fork server, unless it runs already or the system has none.

    The server and its workers ignore Ctrl-C. Raises OSError if the server cannot be started, or if the socket of a
    running server has been removed.
    """
    if context().get_start_method() != "forkserver":
        return
    from multiprocessing import forkserver

    with START_LOCK:
        # The resource tracker starts first, because its start unblocks SIGINT, which must be blocked below.
        resource_tracker.ensure_running()
        signals = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        if not any(Path(util.get_temp_dir()).glob("listener-*")):
            raise FileNotFoundError("no process can be started: a socket has been removed; start this program again")
