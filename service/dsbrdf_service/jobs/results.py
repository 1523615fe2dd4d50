"""What is kept in memory of finished fits, so that a request for values reads and fits nothing.

Models with their components, and views: what a page shows of a fit beside its measurement, which takes up to a second.
"""

from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool

from dsbrdf import DSBRDF, Component, Decomposition, FitReport
from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.fitting.layer_shares import LABELS
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.output.figures import slice_means
from dsbrdf.output.report_text import component_document
from dsbrdf.output.serialize import fit_from_json

from ..errors import ProblemError
from ..storage.schema import FitKey, FitRow
from ..storage.store import Store
from ..wire.fit_options import from_wire
from .steps import LIGHT_STEP, POLAR_ANGLES, Drawn, StoredMeasurement, in_plane, view_step

Array = NDArray[np.float64]

_KEPT = 32  # views, of some 300 kB each
_CURVE_ANGLES = np.linspace(0.0, 1.0, 160) ** 2 * np.pi / 2  # dense at the peak
_DIGITS = 4


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


@dataclass(frozen=True, eq=False)
class FitView:
    """A fit beside its measurement; `horizon_cutoff` bounds the angles of the samples in the means of `drawn` [rad]."""

    drawn: Drawn
    horizon_cutoff: float | None
    decomposition: Decomposition

    def profile(self, row: int) -> dict[str, Any]:
        """Return curves over theta_half at one row of theta_diff, in JSON's types; values in 1/sr, by channel."""
        measured = None if self.drawn.measured is None else self.drawn.measured[:, row]
        return {
            "theta_diff_deg": round(float(np.degrees(THETA_DIFF[row])), _DIGITS),
            "node_theta_half_deg": _rounded(np.degrees(THETA_HALF)),
            "measured": None if measured is None else [_rounded(channel) for channel in measured],
            "theta_half_deg": _rounded(np.degrees(_CURVE_ANGLES)),
            **self._of_components(lambda model: slice_means(model, row, self.horizon_cutoff, _CURVE_ANGLES)),
        }

    def plane_of_incidence(self, light: int) -> dict[str, Any]:
        """Return curves over the viewer's angle for one angle of the light [degrees], as `profile` does."""
        measured = None if self.drawn.polar is None else self.drawn.polar[light // LIGHT_STEP]
        angles = in_plane(np.array([light]))
        return {
            "theta_in_deg": light,
            "theta_out_deg": POLAR_ANGLES.tolist(),
            "measured": None if measured is None else [_rounded(channel) for channel in measured.T],
            **self._of_components(lambda model: model.evaluate(*angles)[0]),
        }

    def _of_components(self, values: Callable[[ReflectanceModel], Array]) -> dict[str, Any]:
        """Return curves of the fit and of its components, from what gives the values (n, 3) of a model."""

        def curves(model: ReflectanceModel) -> list[list[float | None]]:
            return [_rounded(channel) for channel in values(model).T]

        components = [
            {"label": part.label, "place": LABELS.index(part.label), "values": curves(part)}
            for part in self.decomposition
        ]
        return {"fit": curves(self.decomposition.model), "components": components}


class FitViews:
    """The views used last, by fit."""

    def __init__(self, store: Store, models: ModelCache) -> None:
        self._store = store
        self._models = models
        self._views: OrderedDict[FitKey, FitView] = OrderedDict()

    async def get(self, row: FitRow, run: Callable[..., Awaitable[Any]]) -> FitView:
        """Return the view of a fit, made by `run(key, step, *arguments)`; raises as `ModelCache.get`."""
        decomposition = (await self._models.get(row.key)).decomposition
        view = self._views.get(row.key)
        if view is None or view.decomposition is not decomposition:
            stored = await run_in_threadpool(self._measurement, row)
            cutoff = from_wire(row.options).horizon_cutoff
            drawn = await run(("view", row.key, id(decomposition)), view_step, decomposition.model, stored, cutoff)
            view = self._views[row.key] = FitView(drawn, cutoff, decomposition)
            while len(self._views) > _KEPT:
                self._views.popitem(last=False)
        self._views.move_to_end(row.key)
        return view

    def _measurement(self, row: FitRow) -> StoredMeasurement | None:
        """Return the fit's measurement, unless it has been deleted or is none on a grid."""
        try:
            return StoredMeasurement(
                self._store.measurement_file(row.owner, row.measurement, drawn=True), row.measurement
            )
        except ProblemError as error:
            if error.kind != "not-found":
                raise
            return None


def _rounded(values: Array) -> list[float | None]:
    """Return numbers to four digits, as many as a screen can show; None where there is none."""
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]
