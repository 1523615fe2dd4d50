"""Computations in processes of their own: the side that starts, hears and ends them, all in one event loop.

A process may be killed, crash, hang or run out of memory: that is the outcome of its computation and affects no other.
`dsbrdf.engines.worker` is the side that computes.
"""

import asyncio
import logging
import math
import os
import signal
import socket
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from multiprocessing import connection
from multiprocessing.reduction import ForkingPickler
from threading import Thread
from typing import Any

from dsbrdf.engines.engine import MEMORY_LIMIT, NOT_STARTED, Fault, FitLimits, OnProgress
from dsbrdf.engines.fork_server import START_LOCK, context, start_fork_server, starting
from dsbrdf.engines.worker import HEAD, OUT_OF_MEMORY, run_in_worker

_EXIT_TIMEOUT = 5.0  # seconds that a process has to end after it has sent its outcome
_EXIT_INTERVAL = 0.005  # seconds between two looks at whether it has ended
_PIECE = 1 << 18  # bytes that are received at once
# Exit codes of a process that an operator or the kernel ended, so that another attempt may succeed.
_ENDED_FROM_OUTSIDE = [
    -getattr(signal, name) for name in ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT") if hasattr(signal, name)
]
_NOTHING = object()  # instead of the outcome of a process that has died
_UNKNOWN_EXIT = 255  # reported by multiprocessing when the fork server is gone

logger = logging.getLogger(__name__)


class Processes:
    """At most `count` processes at once, each with the limits; further calls wait.

    They are heard by a thread, or without `in_thread` by who calls `serve`.
    """

    def __init__(self, count: int, limits: FitLimits, *, in_thread: bool = True) -> None:
        self._places, self._limits = asyncio.Semaphore(count), limits
        self._unfinished: set[_Call] = set()
        self._closed = False
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, name="dsbrdf-processes", daemon=True)
        if in_thread:
            self._thread.start()

    def call(
        self, step: Callable[..., Any], *arguments: Any, on_progress: OnProgress = lambda _: None
    ) -> "Future[Any]":
        """Call ``step(*arguments, on_progress)`` in a new process; the future gets what it returns, or a `Fault`.

        The step is importable, and its arguments can be pickled. `Future.cancel` ends the process; the future is done
        when it has ended.
        """
        call = _Call()
        self._unfinished.add(call)
        call.add_done_callback(self._unfinished.discard)
        running = asyncio.run_coroutine_threadsafe(self._settle(call, on_progress, step, arguments), self._loop)
        call.stop = running.cancel
        if self._closed:
            call.cancel()
        return call

    def check(self) -> None:
        """Start the server from which processes are forked, unless it runs; RuntimeError if it cannot be started."""
        start_fork_server()

    def serve(self, seconds: float) -> None:
        """Hear the processes for so many seconds."""
        self._loop.run_until_complete(asyncio.sleep(seconds))

    def close(self) -> None:
        """End all processes, and return when they have ended."""
        self._closed = True
        for call in self._unfinished.copy():
            call.cancel()
        if self._thread.ident is None:
            self._loop.run_until_complete(_end_of_others())
        else:
            asyncio.run_coroutine_threadsafe(_end_of_others(), self._loop).result()
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
        self._loop.close()

    async def _settle(
        self, call: "_Call", on_progress: OnProgress, step: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> None:
        async with self._places:
            if not call.set_running_or_notify_cancel():
                return
            outcome: Any = CancelledError()
            try:
                outcome = await self._run(on_progress, step, arguments)
            except asyncio.CancelledError:
                pass
            except Exception as error:  # the arguments cannot be sent, or who is told the progress fails
                outcome = error
            finally:
                call.settle(outcome)

    async def _run(self, on_progress: OnProgress, step: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Start a process; hear it until its outcome comes, it dies or its time is up; return when it has ended."""
        ours, its = socket.socketpair()
        process = context().Process(
            target=run_in_worker, args=(its, self._limits, step, arguments), name="dsbrdf-fit", daemon=True
        )
        seconds, patience = self._limits.seconds, 0.0
        with ours:
            try:
                with its, starting():
                    process.start()
            except (OSError, EOFError) as error:
                logger.exception("the process of a fit could not be started")
                return Fault("system", NOT_STARTED, f"The fit's process could not be started: {error}.")
            try:
                async with asyncio.timeout(seconds if math.isfinite(seconds) else None):
                    outcome = await _outcome(ours, on_progress)
                patience = _EXIT_TIMEOUT
            except TimeoutError:
                message = f"The fit took longer than the {seconds:g} s that a fit may take."
                outcome = Fault("compute", "TimeLimit", message)
            except (EOFError, ConnectionError):
                outcome, patience = _NOTHING, _EXIT_TIMEOUT
            finally:
                code = await _end(process, patience)
        return _fault_of_exit(code) if outcome is _NOTHING else outcome


class _Call(Future[Any]):
    """A future that can be cancelled while its work is done: `stop` ends the work, and the future is done after it."""

    def __init__(self) -> None:
        super().__init__()
        self.stop: Callable[[], object] = lambda: None
        self.is_stopped = False

    def cancel(self) -> bool:
        self.is_stopped = True
        if super().cancel():  # it has not been begun
            return True
        self.stop()
        return False

    def settle(self, outcome: Any) -> None:
        if self.is_stopped:
            outcome = CancelledError()
        if isinstance(outcome, Exception):
            self.set_exception(outcome)
        else:
            self.set_result(outcome)


async def _outcome(pipe: socket.socket, on_progress: OnProgress) -> Any:
    """Receive messages until the outcome comes."""
    pipe.setblocking(False)
    while True:
        size = int.from_bytes(await _receive(pipe, HEAD))
        kind, content = ForkingPickler.loads(await _receive(pipe, size))
        if kind == "outcome":
            return content
        if kind == "progress":
            on_progress(content)
        elif logging.getLogger(content.name).isEnabledFor(content.levelno):
            logging.getLogger(content.name).handle(content)


async def _receive(pipe: socket.socket, size: int) -> bytearray:
    """Return so many bytes; raise EOFError if the other side ends before them."""
    data = bytearray()
    while len(data) < size:
        piece = await asyncio.get_running_loop().sock_recv(pipe, min(size - len(data), _PIECE))
        if not piece:
            raise EOFError
        data += piece
    return data


async def _end(process: Any, patience: float) -> int | None:
    """Return the exit code of a process when it has ended; one that takes longer than some seconds is killed."""
    deadline = time.monotonic() + patience
    while not connection.wait([process.sentinel], 0.0):
        if time.monotonic() >= deadline:
            _kill(process)
        try:
            await asyncio.sleep(_EXIT_INTERVAL)
        except asyncio.CancelledError:
            deadline = 0.0
    with START_LOCK:
        process.join()
    code: int | None = process.exitcode
    if code == _UNKNOWN_EXIT:
        _kill(process)
    return code


def _kill(process: Any) -> None:
    with suppress(ProcessLookupError):  # not `Process.kill`, which does nothing without the fork server
        os.kill(process.pid, getattr(signal, "SIGKILL", signal.SIGTERM))


async def _end_of_others() -> None:
    while others := asyncio.all_tasks() - {asyncio.current_task()}:
        await asyncio.wait(others)


def _fault_of_exit(code: int | None) -> Fault:
    if code == OUT_OF_MEMORY:
        return MEMORY_LIMIT
    reason = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
    if code in _ENDED_FROM_OUTSIDE or code == _UNKNOWN_EXIT:
        return Fault("system", "ProcessLost", f"The fit's process was ended from outside ({reason}).")
    return Fault("compute", "ProcessCrashed", f"The fit's process crashed ({reason}).")
