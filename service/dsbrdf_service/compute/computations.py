"""Run computations for requests, and cache fitted models with their components.

Callers take turns, and a computation ends when its client has left. Every route that computes more than a few values
uses `Computations`. A computation that takes more than some 50 ms runs in a separate process.
"""

import asyncio
import errno
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeVar, get_args

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
from ..storage.files import Writing
from ..storage.schema import FitKey
from ..storage.store import Store
from . import steps

T = TypeVar("T")

Duration = Literal["short", "medium", "long"]
"""Class of a computation by its duration: at most some 50 ms, about a second, or longer."""
_TOO_COSTLY = {
    "MemoryLimit": "The computation takes more than {0.memory_mb} MB, its limit; ask for fewer values at once.",
    "ProcessorLimit": "The computation takes more than {0.processor_seconds:g} s, its limit; ask for fewer values.",
}


class Computations:
    """Run at most one computation of each `Duration` at a time; callers take turns.

    A computation is cancelled when its client has closed the connection. The process of a cancelled computation is
    killed, but a call in a thread keeps its turn until the call returns. Every process has the `limits`, except that
    their niceness applies only to long computations.
    """

    def __init__(self, limits: FitLimits, writing: Writing) -> None:
        preload(steps.__name__)
        self._writing = writing
        self._turns = {duration: FairTurns() for duration in get_args(Duration)}
        self._limits = limits
        at_once = replace(limits, niceness=0)
        self._processes = {"medium": Processes(1, at_once), "long": Processes(1, limits)}
        self._unfinished: dict[asyncio.Task[Any], CancelScope] = {}

    async def run(self, request: Request, compute: Callable[[], T]) -> T:
        """Call `compute` in a thread and return its result; the body of the `request` must have been read.

        Raises ClientDisconnect if the client has closed the connection.
        """
        result: T = await self._wait(request, partial(run_in_threadpool, compute), "short")
        return result

    async def run_in_process(
        self,
        request: Request,
        step: Callable[..., Any],
        *arguments: Any,
        max_bytes: int = 0,
        duration: Duration = "medium",
    ) -> Any:
        """Call ``step(*arguments, on_progress)`` in a separate process and return its result.

        With `max_bytes`, the step gets a path after its arguments and writes a file of at most this length, which is
        returned open, and deleted when the answer has sent it.

        `step` must be importable without the service, and `arguments` must be picklable. Raises the errors of `run`,
        InvalidArgumentError if the step refuses its arguments, OSError if the file cannot be written, and ProblemError
        if the step fails or the caller has too many files in progress.
        """

        async def work() -> Any:
            if not max_bytes:
                return await self._called(duration, step, *arguments)
            async with self._writing.answer(request.scope[CALLER], max_bytes) as (file, path):
                await self._called(duration, step, *arguments, path)
            return file

        return await self._wait(request, work, duration)

    async def _called(self, duration: Duration, step: Callable[..., Any], *arguments: Any) -> Any:
        found = await result_of(self._processes[duration].call(step, *arguments))
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

    async def close(self) -> None:
        """Cancel all computations, and wait for their processes to end."""
        for scope in self._unfinished.values():
            scope.cancel()
        await asyncio.gather(*self._unfinished, return_exceptions=True)
        for processes in self._processes.values():
            await asyncio.to_thread(processes.close)

    async def _wait(self, request: Request, work: Callable[[], Awaitable[Any]], duration: Duration) -> Any:
        """Return the result of `work`, which is cancelled when the client closes the connection."""
        scope = CancelScope()

        async def compute() -> Any:
            with scope:
                async with self._turns[duration].turn(request.scope[CALLER_NAME]):
                    return await work()

        task, gone = asyncio.create_task(compute()), asyncio.create_task(departure(request))
        self._unfinished[task] = scope
        task.add_done_callback(self._forget)
        try:
            await asyncio.wait((task, gone), return_when=asyncio.FIRST_COMPLETED)
            if not task.done():
                raise ClientDisconnect
            return task.result()
        finally:
            gone.cancel()
            scope.cancel()

    def _forget(self, task: "asyncio.Task[Any]") -> None:
        del self._unfinished[task]
        if not task.cancelled():
            task.exception()  # Unless the exception is read here, asyncio logs that nobody read it.


async def departure(request: Request) -> None:
    """Wait until the client has closed the connection."""
    with suppress(ProblemError):  # A client that sends the rest of a body too slowly counts as gone.
        while (await request.receive())["type"] != "http.disconnect":
            pass


@dataclass(frozen=True)
class LoadedFit:
    """The model of a fit with its components, and the report of the fit."""

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
    """The angles of simultaneous requests for values of one model, and the task that evaluates all of them."""

    task: "asyncio.Task[Array]"
    angles: list[tuple[Array, ...]] = field(default_factory=list)
    n_points: int = 0


class ModelCache:
    """Cache the models of the fits that were used last, at most `size` of them."""

    def __init__(self, store: Store, size: int) -> None:
        self._store = store
        self._size = size
        self._models: OrderedDict[tuple[FitKey, int | None], LoadedFit] = (
            OrderedDict()
        )  # The keys are a fit and the checksum of its result.
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
