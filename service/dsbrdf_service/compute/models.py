"""Cache fitted models with their components, so that requests for values do not parse stored results."""

import asyncio
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
from starlette.concurrency import run_in_threadpool

from dsbrdf import DSBRDF, Component, Decomposition, FitReport
from dsbrdf.arrays import Array
from dsbrdf.output.serialize import fit_from_json

from ..errors import ProblemError
from ..storage.schema import FitKey
from ..storage.store import Store


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
