"""How worker processes are started: forked from a server that has the library loaded, which this process starts once.

They do not share memory or connections with the process that asks for them. Without fork servers each is a new
interpreter, which takes longer.
"""

import multiprocessing
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker, util
from pathlib import Path
from typing import Any

preloaded = ["dsbrdf.engines.fork_server_preload"]
"""Modules that the server imports when it starts."""
START_LOCK = threading.Lock()
"""Held while a process is started or its exit code is collected: each start collects those of others too."""


def context() -> Any:
    """Return the context of `multiprocessing` whose processes are workers."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    forking = multiprocessing.get_context("forkserver")
    forking.set_forkserver_preload(preloaded)
    return forking


def start_fork_server() -> None:
    """Start the server from which worker processes are forked, unless it runs or this system has none.

    Raises RuntimeError if it cannot be started, or be reached because its socket has been removed.
    """
    if context().get_start_method() != "forkserver":
        return
    from multiprocessing import forkserver

    try:
        with starting():
            forkserver.ensure_running()
            reachable = any(Path(util.get_temp_dir()).glob("listener-*"))
    except OSError as error:
        raise RuntimeError(f"no process can be started: {error}") from error
    if not reachable:
        raise RuntimeError("no process can be started: a socket has been removed; start this program again")


@contextmanager
def starting() -> Iterator[None]:
    """Hold the conditions under which worker processes and their server are started, one at a time.

    Ctrl-C is blocked, so that they are not interrupted even during their imports. The program's main module is hidden:
    they do not need it, and a script without ``if __name__ == "__main__"`` would start itself again and again.
    """
    main, blocks_signals = vars(sys.modules["__main__"]), hasattr(signal, "pthread_sigmask")
    with START_LOCK:
        if blocks_signals:
            resource_tracker.ensure_running()  # starting it later, with the first process, would unblock interrupts
            signals = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        shown: dict[str, Any] = {name: main[name] for name in ("__spec__", "__file__") if name in main}
        try:
            main["__spec__"] = None
            main.pop("__file__", None)
            yield
        finally:
            main.update(shown)
            if blocks_signals:
                signal.pthread_sigmask(signal.SIG_SETMASK, signals)
