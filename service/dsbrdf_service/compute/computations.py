"""Run computations for requests, and cache fitted models with their components.

Equal computations run once, callers take turns, and unneeded computations are cancelled. Every route that computes more
than a few values uses `Computations`. A computation that takes more than some 50 ms runs in a separate process.
"""

import asyncio
import errno
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeVar, get_args
from weakref import WeakValueDictionary

import numpy as np
from anyio import CancelScope
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from dsbrdf import DSBRDF, Component, Decomposition, FitReport
from dsbrdf.arrays import Array
from dsbrdf.engines.engine import DISK_FULL, Fault, FitLimits
from dsbrdf.engines.local import Processes, preload
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.output.serialize import fit_from_json

from ..access import CALLER, CALLER_NAME
from ..errors import ProblemError
from ..queue import FairTurns, result_of
from ..storage.files import OpenFile, Writing
from ..storage.schema import FitKey
from ..storage.store import Store
from . import steps

T = TypeVar("T")

Place = Literal["short", "medium", "long"]
"""Class of a computation by its duration: at most some 50 ms, about a second, or longer."""
_TOO_COSTLY = {
    "MemoryLimit": "The computation takes more than {0.memory_mb} MB, its limit; ask for fewer values at once.",
    "ProcessorLimit": "The computation takes more than {0.processor_seconds:g} s, its limit; ask for fewer values.",
}


@dataclass
class _Computation:
    """Hold a computation that runs or waits for its turn, and the number of requests that wait for its result."""

    task: "asyncio.Task[Any]"
    scope: CancelScope
    n_waiting: int = 0


class Computations:
    """Run at most one computation of each `Place` at a time; callers take turns.

    A computation is cancelled when the last client that waits for it has closed its connection. The process of a
    cancelled computation is killed, but a call in a thread keeps its turn until the call returns. Every process has the
    `limits`, except that their niceness applies only to long computations.
    """

    def __init__(self, limits: FitLimits) -> None:
        preload(steps.__name__)
        self._turns = {place: FairTurns() for place in get_args(Place)}
        self._limits = limits
        at_once = replace(limits, niceness=0)
        self._processes = {"medium": Processes(1, at_once), "long": Processes(1, limits)}
        self._in_progress: dict[Hashable, _Computation] = {}
        # Files that are still being sent, by the key of their computation, so that equal requests share a file.
        self._files: WeakValueDictionary[Hashable, OpenFile] = WeakValueDictionary()

    async def run(self, request: Request, key: Hashable, compute: Callable[[], T]) -> T:
        """Call `compute` in a thread and return its result.

        Simultaneous requests with an equal `key`, which contains the owner, share one call. The body of the `request`
        must have been read.

        Raises ClientDisconnect if the client has closed the connection.
        """
        result: T = await self._wait(request, key, partial(run_in_threadpool, compute), "short")
        return result

    async def run_in_process(
        self, request: Request, key: Hashable, step: Callable[..., Any], *arguments: Any, place: Place = "medium"
    ) -> Any:
        """Call ``step(*arguments, on_progress)`` in a separate process and return its result.

        `step` must be importable without the service, and `arguments` must be picklable; `key` is as for `run`. Raises
        the errors of `run`, InvalidArgumentError if the step refuses its arguments, and ProblemError if the step fails.
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
        """Call ``step(*arguments, path, on_progress)`` as `run_in_process` does, and return the file that it writes.

        The file is deleted when the last answer has sent it; until then, all requests with its `key` get this file.

        Raises the errors of `run_in_process`, OSError if the file cannot be written, and ProblemError if the caller has
        too many files in progress.
        """

        async def work() -> OpenFile:
            async with writing.answer(request.scope[CALLER], max_bytes) as (file, path):
                await self._called(place, step, *arguments, path)
            self._files[key] = file
            return file

        made: OpenFile = self._files.get(key) or await self._wait(request, key, work, place)
        return made

    async def close(self) -> None:
        """Cancel all computations, and wait for their processes to end."""
        unfinished = list(self._in_progress.values())
        for computation in unfinished:
            computation.scope.cancel()
        await asyncio.gather(*(computation.task for computation in unfinished), return_exceptions=True)
        for processes in self._processes.values():
            await asyncio.to_thread(processes.close)

    async def _wait(self, request: Request, key: Hashable, work: Callable[[], Awaitable[Any]], place: Place) -> Any:
        """Return the result of `work`, or of the running computation with an equal key."""

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
                self._forget(key, computation.task)  # A request that comes now starts a new computation.
                computation.scope.cancel()

    def _forget(self, key: Hashable, task: "asyncio.Task[Any]") -> None:
        if key in self._in_progress and self._in_progress[key].task is task:
            del self._in_progress[key]
        if task.done() and not task.cancelled():
            task.exception()  # Unless the exception is read here, asyncio logs that nobody read it.


async def departure(request: Request) -> None:
    """Return when the client has closed the connection."""
    with suppress(ProblemError):  # A client that sends the rest of a body too slowly counts as gone.
        while (await request.receive())["type"] != "http.disconnect":
            pass


@dataclass(frozen=True)
class LoadedFit:
    """Hold the model of a fit with its components, and the report of the fit."""

    decomposition: Decomposition
    report: FitReport | None

    @property
    def model(self) -> DSBRDF:
        """The model."""
        return self.decomposition.model

    def part(self, label: str | None) -> DSBRDF | Component:
        """Return the model, or its component with a label; raise ProblemError if the model has no such component."""
        if label is None:
            return self.model
        labels = self.decomposition.labels
        if label not in labels:
            there = f"it has {' and '.join(labels)}" if labels else "it reflects no light"
            raise ProblemError("not-found", f"The fit has no component {label}: {there}.")
        return self.decomposition[label]


@dataclass
class _Batch:
    """Hold the angles of simultaneous requests for values of one model, and the task that evaluates all of them."""

    task: "asyncio.Task[Array]"
    angles: list[tuple[Array, ...]] = field(default_factory=list)
    n_points: int = 0


class ModelCache:
    """Cache the models of the fits that were used last, at most `size` of them."""

    def __init__(self, store: Store, size: int) -> None:
        self._store = store
        self._size = size
        self._models: OrderedDict[tuple[FitKey, int | None], LoadedFit] = OrderedDict()  # By fit and result's checksum.
        self._batches: dict[tuple[FitKey, str | None], _Batch] = {}  # Batches by fit and component label.

    async def get(self, key: FitKey) -> LoadedFit:
        """Return the model of a fit; raise ProblemError if there is no such fit, or it has no result.

        The store is queried each time, because another process may have deleted the fit or computed it again.
        """
        stamp = self._store.result_stamp(key)
        if (key, stamp) in self._models:
            self._models.move_to_end((key, stamp))
            return self._models[key, stamp]
        loaded = LoadedFit(*await run_in_threadpool(lambda: fit_from_json(self._store.result(key).decode())))
        if stamp is not None:  # Without a stamp, the fit had no result a moment ago, so its result is not cached yet.
            loaded = self._models.setdefault((key, stamp), loaded)  # Another request may have loaded the fit.
            if len(self._models) > self._size:
                self._models.popitem(last=False)
        return loaded

    async def evaluate(self, key: FitKey, label: str | None, *angles: Array) -> Array:
        """Return the values (n, 3) of a fit, or of one component, at a few points.

        `angles` are the checked theta_half, theta_diff and phi_diff of the points, shape (n,) each [rad]. Requests that
        come while others are read are evaluated together, because NumPy takes as long for 16 points as for one. Raises
        ProblemError as `get` and `LoadedFit.part`.
        """
        batch = self._batches.get((key, label))
        if batch is None:
            batch = self._batches[key, label] = _Batch(asyncio.create_task(self._evaluate(key, label)))
        start, batch.n_points = batch.n_points, batch.n_points + len(angles[0])
        batch.angles.append(angles)
        values = await asyncio.shield(batch.task)  # A cancelled request must not cancel the values of others.
        return values[start : start + len(angles[0])]

    async def _evaluate(self, key: FitKey, label: str | None) -> Array:
        """Evaluate the batch of a model; later requests make a new batch, because the fit may be deleted meanwhile."""
        batch = self._batches.pop((key, label))
        model = (await self.get(key)).part(label)
        return model.evaluate(*map(np.concatenate, zip(*batch.angles, strict=True)))
