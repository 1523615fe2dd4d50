"""The server from which worker processes are forked, with the library loaded; this process starts it once.

They do not share memory or connections with the process that asks for them. Without fork servers each is a new
interpreter, which takes longer.
"""

import multiprocessing
import signal
import sys
import threading
from multiprocessing import resource_tracker, util
from pathlib import Path
from typing import Any

START_LOCK = threading.Lock()
"""Held while a process is started or its exit code is collected: each start collects those of others too."""


def context() -> Any:
    """Return the context of `multiprocessing` whose processes are workers."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    forking = multiprocessing.get_context("forkserver")
    # Every worker would import these.
    forking.set_forkserver_preload(["dsbrdf.engines.fork_server_preload", *({"distributed"} & sys.modules.keys())])
    return forking


def start_fork_server() -> None:
    """Start the server, unless it runs or this system has none; Ctrl-C reaches neither it nor what it forks.

    Raises OSError if it cannot be started, or be reached because its socket has been removed.
    """
    if context().get_start_method() != "forkserver":
        return
    from multiprocessing import forkserver

    with START_LOCK:
        resource_tracker.ensure_running()  # starting it later, with the server, would unblock interrupts
        signals = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        if not any(Path(util.get_temp_dir()).glob("listener-*")):
            raise FileNotFoundError("no process can be started: a socket has been removed; start this program again")
