"""What requests compute: once for all who wait for it, the callers in turns, and only as long as somebody waits.

Every route that computes more than a few values goes through `Computations`. What takes longer than some 50 ms is
computed in a process of its own, which gives way to the one that answers.
"""

import asyncio
import errno
from collections.abc import Awaitable, Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeVar, get_args
from weakref import WeakValueDictionary

from anyio import CancelScope
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from dsbrdf.engines.engine import DISK_FULL, Fault, FitLimits
from dsbrdf.engines.processes import Processes
from dsbrdf.errors import InvalidArgumentError

from ..access.authentication import CALLER, CALLER_NAME
from ..errors import ProblemError
from ..queue.turns import FairTurns, result_of
from ..storage.blobs import OpenFile
from ..storage.writing import Writing

T = TypeVar("T")

Place = Literal["short", "medium", "long"]
"""Where something is computed, by its time: at most some 50 ms, about a second, or longer."""
_TOO_COSTLY = {
    "MemoryLimit": "The computation takes more than {0.memory_mb} MB, its limit; ask for fewer values at once.",
    "ProcessorLimit": "The computation takes more than {0.processor_seconds:g} s, its limit; ask for fewer values.",
}


@dataclass
class _Computation:
    """What is being computed, or waits for its turn, and how many requests wait for it."""

    task: "asyncio.Task[Any]"
    scope: CancelScope
    n_waiting: int = 0


class Computations:
    """Computes one thing at a time in each place; callers take turns there.

    What is computed is given up when the last request that waits for it has been given up by its client: a process is
    ended, a call in a thread keeps its turn until it has ended. The processes have `limits` of their own; long
    computations alone give way to all others by their niceness.
    """

    def __init__(self, limits: FitLimits) -> None:
        self._turns = {place: FairTurns() for place in get_args(Place)}
        self._limits = limits
        at_once = replace(limits, niceness=0)
        self._processes = {"medium": Processes(1, at_once), "long": Processes(1, limits)}
        self._in_progress: dict[Hashable, _Computation] = {}
        # Files that somebody still reads, by what they are.
        self._files: WeakValueDictionary[Hashable, OpenFile] = WeakValueDictionary()

    async def run(self, request: Request, key: Hashable, compute: Callable[[], T]) -> T:
        """Return what `compute` returns, which is called in a thread.

        Requests with one `key` that come together get one result; it names the owner too. The body of the `request`
        must have been read.

        Raises ClientDisconnect if the client has closed the connection.
        """
        result: T = await self._wait(request, key, partial(run_in_threadpool, compute), "short")
        return result

    async def run_in_process(
        self,
        request: Request,
        key: Hashable,
        step: Callable[..., Any],
        *arguments: Any,
        place: Place = "medium",
    ) -> Any:
        """Return what ``step(*arguments, on_progress)`` returns, which is called in a process of its own.

        `step` is importable without the service, and `arguments` can be pickled; the rest is as for `run`. Raises
        InvalidArgumentError too if the arguments do not allow it, and ProblemError if it could not be computed.
        """
        return await self._wait(request, key, partial(self._called, place, step, *arguments), place)

    async def _called(self, place: Place, step: Callable[..., Any], *arguments: Any) -> Any:
        found = await result_of(self._processes[place].call(step, *arguments))
        if not isinstance(found, Fault):
            return found
        if found.origin == "input":
            raise InvalidArgumentError(found.message)
        if found == DISK_FULL:
            raise OSError(errno.ENOSPC, found.message)
        if found.type in ("MemoryLimit", "ProcessorLimit"):
            raise ProblemError("too-costly", _TOO_COSTLY[found.type].format(self._limits))
        if found.origin == "system" or found.type == "TimeLimit":
            raise ProblemError("interrupted", f"The computation was interrupted ({found.type}); try again.")
        raise ProblemError("internal", f"The service failed to compute the answer ({found.type}); its log says why.")

    async def make_file(
        self,
        request: Request,
        key: Hashable,
        step: Callable[..., Any],
        *arguments: Any,
        writing: Writing,
        max_bytes: int,
        place: Place = "medium",
    ) -> OpenFile:
        """Return the file that ``step(*arguments, path, on_progress)`` writes, which is called as by `run_in_process`.

        It goes with the last request that has it; until then, requests with its `key` get this file.

        Raises OSError too if it cannot be made, and ProblemError if the caller has too many files in progress.
        """

        async def work() -> OpenFile:
            async with writing.answer(request.scope[CALLER], max_bytes) as (file, path):
                await self._called(place, step, *arguments, path)
            self._files[key] = file
            return file

        made: OpenFile = self._files.get(key) or await self._wait(request, key, work, place)
        return made

    async def close(self) -> None:
        """Give up what is being computed."""
        unfinished = list(self._in_progress.values())
        for computation in unfinished:
            computation.scope.cancel()
        await asyncio.gather(*(computation.task for computation in unfinished), return_exceptions=True)
        for processes in self._processes.values():
            await asyncio.to_thread(processes.close)

    async def _wait(self, request: Request, key: Hashable, work: Callable[[], Awaitable[Any]], place: Place) -> Any:
        """Return the result of `work`, or of what is being computed with this key already."""

        async def compute(scope: CancelScope) -> Any:
            with scope:
                async with self._turns[place].turn(request.scope[CALLER_NAME]):
                    return await work()

        computation = self._in_progress.get(key)
        if computation is None:
            scope = CancelScope()
            computation = self._in_progress[key] = _Computation(asyncio.create_task(compute(scope)), scope)
            computation.task.add_done_callback(lambda task: self._forget(key, task))
        computation.n_waiting += 1
        gone = asyncio.create_task(departure(request))
        try:
            await asyncio.wait((computation.task, gone), return_when=asyncio.FIRST_COMPLETED)
            if not computation.task.done():
                raise ClientDisconnect
            return computation.task.result()
        finally:
            gone.cancel()
            computation.n_waiting -= 1
            if not computation.n_waiting and not computation.task.done():
                self._forget(key, computation.task)  # who asks now begins anew
                computation.scope.cancel()

    def _forget(self, key: Hashable, task: "asyncio.Task[Any]") -> None:
        if key in self._in_progress and self._in_progress[key].task is task:
            del self._in_progress[key]
        if task.done() and not task.cancelled():
            task.exception()  # perhaps nobody waits for it any more


async def departure(request: Request) -> None:
    """Return when the client has closed the connection."""
    with suppress(ProblemError):  # A body that nobody reads may arrive too slowly.
        while (await request.receive())["type"] != "http.disconnect":
            pass
