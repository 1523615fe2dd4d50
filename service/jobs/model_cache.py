"""The models of finished fits, the last used ones kept in memory: evaluating one costs a look-up."""

from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property

from starlette.concurrency import run_in_threadpool

from dsbrdf import DSBRDF, Decomposition, FitReport, InvalidArgumentError, decompose
from dsbrdf.model.decomposition import LABELS
from dsbrdf.output.serialize import from_json
from service.http.problems import ProblemError
from service.storage.rows import FitKey
from service.storage.store import Store


@dataclass(frozen=True)
class Loaded:
    """A fit's model and report."""

    model: DSBRDF
    report: FitReport | None

    @cached_property
    def decomposition(self) -> Decomposition:
        """The model's components; they take some milliseconds once."""
        return decompose(self.model)


class Models:
    """Models by fit, in the order of their last use.

    Parameters
    ----------
    store : Store
    size : int
        How many to keep.
    """

    def __init__(self, store: Store, size: int) -> None:
        self._store = store
        self._size = size
        self._kept: OrderedDict[FitKey, Loaded] = OrderedDict()
        self._deletions = 0

    async def get(self, key: FitKey) -> Loaded:
        """Return the model of a fit.

        Raises
        ------
        ProblemError
            If there is no such fit, or it has no result.
        """
        loaded = self._kept.get(key)
        if loaded is not None:
            self._kept.move_to_end(key)
            return loaded
        deletions = self._deletions
        loaded = await run_in_threadpool(self._load, key)
        if deletions != self._deletions:  # perhaps of this fit, after it was read
            return loaded
        self._kept[key] = loaded
        while len(self._kept) > self._size:
            self._kept.popitem(last=False)
        return loaded

    async def part(self, key: FitKey, label: str | None) -> DSBRDF:
        """Return the model of a fit, or of one of its components.

        Raises
        ------
        ProblemError
            As `get`, or if there is no such label.
        """
        if label is None:
            return (await self.get(key)).model
        decomposition = await self.decomposition(key)
        try:
            return decomposition[label]
        except InvalidArgumentError:
            detail = f"There is no component {label[:40]!r}; a fit has {', '.join(LABELS)}."
            raise ProblemError("not-found", detail) from None

    async def decomposition(self, key: FitKey) -> Decomposition:
        """Return the components of a fit; raises as `get`."""
        loaded = await self.get(key)
        return await run_in_threadpool(lambda: loaded.decomposition)

    def forget(self, key: FitKey) -> None:
        """Drop a model whose fit is deleted."""
        self._deletions += 1
        self._kept.pop(key, None)

    def forget_all(self) -> None:
        """Drop every model, since fits may have been deleted by another process."""
        self._deletions += 1
        self._kept.clear()

    def _load(self, key: FitKey) -> Loaded:
        document = self._store.result(key)
        if document is None:
            raise self._problem(key)
        return Loaded(*from_json(document))

    def _problem(self, key: FitKey) -> ProblemError:
        row = self._store.fit(key)
        if row is None:
            return no_such_fit(key.id)
        if not row.ended:
            detail = f"The fit is {row.status}; its model exists when it has succeeded."
            return ProblemError("fit-not-finished", detail, {"Retry-After": "1"})
        return ProblemError("fit-without-result", f"The fit {row.status} and has no model; its document says why.")


def no_such_fit(fit_id: str) -> ProblemError:
    """Return the problem of an unknown fit."""
    return ProblemError("not-found", f"There is no fit {fit_id[:64]!r}; GET /v1/fits lists those that there are.")


def no_such_measurement(sha256: str) -> ProblemError:
    """Return the problem of an unknown measurement."""
    detail = f"There is no measurement {sha256[:64]!r}; upload it with POST /v1/measurements or POST /v1/fits."
    return ProblemError("not-found", detail)
