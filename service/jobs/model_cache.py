"""The models of finished fits: those used last stay in memory, so that a request for values reads nothing."""

from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property

from starlette.concurrency import run_in_threadpool

from dsbrdf import DSBRDF, Decomposition, FitReport, decompose
from dsbrdf.model.decomposition import LABELS
from dsbrdf.output.serialize import from_json
from service.errors import FitNotFoundError, ProblemError
from service.storage.schema import FitKey
from service.storage.store import Store


@dataclass(frozen=True)
class LoadedFit:
    """A fit's model and report."""

    model: DSBRDF
    report: FitReport | None

    @cached_property
    def decomposition(self) -> Decomposition:
        """The model's components, computed at the first use."""
        return decompose(self.model)


class ModelCache:
    """The `size` models used last, by fit."""

    def __init__(self, store: Store, size: int) -> None:
        self._store = store
        self._size = size
        self._models: OrderedDict[FitKey, LoadedFit] = OrderedDict()
        self._deletions = 0

    async def get(self, key: FitKey) -> LoadedFit:
        """Return the model of a fit.

        Raises ProblemError if there is no such fit, or it has no result.
        """
        loaded = self._models.get(key)
        if loaded is not None:
            self._models.move_to_end(key)
            return loaded
        deletions = self._deletions
        loaded = await run_in_threadpool(self._load, key)
        if deletions != self._deletions:  # perhaps this fit was deleted after it was read
            return loaded
        self._models[key] = loaded
        while len(self._models) > self._size:
            self._models.popitem(last=False)
        return loaded

    async def component(self, key: FitKey, label: str | None) -> DSBRDF:
        """Return the model of a fit, or of one of its components.

        Raises ProblemError: as `get`, or if there is no such label.
        """
        if label is None:
            return (await self.get(key)).model
        decomposition = await self.decomposition(key)
        if label not in LABELS:
            raise ProblemError("not-found", f"There is no component {label[:40]!r}; a fit has {', '.join(LABELS)}.")
        return decomposition[label].model

    async def decomposition(self, key: FitKey) -> Decomposition:
        """Return the components of a fit; raises as `get`."""
        loaded = await self.get(key)
        return await run_in_threadpool(lambda: loaded.decomposition)

    def forget(self, *keys: FitKey) -> None:
        """Drop models whose fits are deleted; without keys all, as any may have been deleted by another process."""
        self._deletions += 1
        for key in keys or tuple(self._models):
            self._models.pop(key, None)

    def _load(self, key: FitKey) -> LoadedFit:
        document = self._store.result(key)
        if document is not None:
            return LoadedFit(*from_json(document))
        row = self._store.fit(key)
        if row is None:
            raise FitNotFoundError(key.id)
        if not row.ended:
            raise ProblemError("fit-not-finished", f"The fit is {row.status}; its model exists when it has succeeded.")
        raise ProblemError("fit-without-result", f"The fit {row.status} and has no model; its document says why.")
