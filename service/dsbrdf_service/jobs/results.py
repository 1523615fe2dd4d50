"""Finished fits that are kept in memory with their components: a request for values reads and fits nothing."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from starlette.concurrency import run_in_threadpool

from dsbrdf import DSBRDF, Component, Decomposition, FitReport
from dsbrdf.output.report_text import component_document
from dsbrdf.output.serialize import fit_from_json

from ..errors import ProblemError
from ..storage.schema import FitKey
from ..storage.store import Store


@dataclass(frozen=True)
class LoadedFit:
    """A fit's model with its components, its report, and what documents say of the components."""

    decomposition: Decomposition
    report: FitReport | None
    components: list[dict[str, Any]]

    @property
    def model(self) -> DSBRDF:
        """The model."""
        return self.decomposition.model

    def part(self, label: str | None) -> DSBRDF | Component:
        """Return the model, or one of its components; raise ProblemError if that has no light."""
        if label is None:
            return self.model
        labels = self.decomposition.labels
        if label not in labels:
            there = f"it has {' and '.join(labels)}" if labels else "it reflects no light"
            raise ProblemError("not-found", f"The fit has no component {label}: {there}.")
        return self.decomposition[label]


class ModelCache:
    """The `size` models used last, by fit."""

    def __init__(self, store: Store, size: int) -> None:
        self._store = store
        self._size = size
        self._models: OrderedDict[FitKey, tuple[int, LoadedFit]] = OrderedDict()  # each with the stamp of its result

    async def get(self, key: FitKey) -> LoadedFit:
        """Return the model of a fit; raise ProblemError if there is no such fit, or it has no result.

        The store is asked each time: another process may have deleted the fit, or computed it once more.
        """
        stamp = self._store.result_stamp(key)
        if (kept := self._kept(key, stamp)) is not None:
            return kept
        loaded = await run_in_threadpool(self._load, key)
        if stamp is None:  # its fit has ended meanwhile
            return loaded
        if (kept := self._kept(key, stamp)) is not None:  # it has come together with this request
            return kept
        self._models[key] = stamp, loaded
        while len(self._models) > self._size:
            self._models.popitem(last=False)
        return loaded

    def _kept(self, key: FitKey, stamp: int | None) -> LoadedFit | None:
        """Return the model that is kept for a result."""
        found, loaded = self._models.get(key, (None, None))
        if loaded is None or found != stamp:
            return None
        self._models.move_to_end(key)
        return loaded

    def _load(self, key: FitKey) -> LoadedFit:
        document = self._store.result(key)
        if document is not None:
            decomposition, report = fit_from_json(document)
            return LoadedFit(decomposition, report, [component_document(component) for component in decomposition])
        row = self._store.fit(key)
        if not row.ended:
            raise ProblemError("fit-not-finished", f"The fit is {row.status}; its model exists when it has succeeded.")
        raise ProblemError("fit-without-result", f"The fit {row.status} and has no model; its document says why.")
