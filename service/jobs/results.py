"""What is kept in memory of finished fits: their models, and what a page shows of them beside their measurements.

The models used last stay with their components, so that a request for values reads and fits nothing. A view, pictures
of lit spheres and slices of fit and measurement, takes up to a second and reads the whole measurement; those used last
stay too, some 300 kB each.
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool

from dsbrdf import (
    DSBRDF,
    Component,
    Decomposition,
    FitReport,
    Measurement,
    decompose,
    profiles,
    read_merl,
)
from dsbrdf.data.geometry import half_difference
from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.data.interpolation import interpolate
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.model.render import render_sphere, sphere_normals
from dsbrdf.output.figures import slice_means
from dsbrdf.output.report_text import component_document
from dsbrdf.output.serialize import from_json
from dsbrdf.output.sphere_panels import DIFFERENCE_GAIN, encode_png
from service.errors import FitNotFoundError, MeasurementNotFoundError, ProblemError
from service.jobs.computations import Run
from service.storage.schema import FitKey, FitRow
from service.storage.store import Store

Array = NDArray[np.float64]

_SIZE = 256
_KEPT = 32
_CURVE_ANGLES = np.linspace(0.0, 1.0, 160) ** 2 * np.pi / 2  # dense at the peak
_DIGITS = 4
LIGHT_STEP = 5
"""Angles of the light in polar plots are multiples of it [degrees]."""
LARGEST_LIGHT = 85
_POLAR_ANGLES = np.arange(-89, 90)  # of the viewer, negative on the light's side [degrees]


@dataclass(frozen=True)
class LoadedFit:
    """A fit's model and report."""

    model: DSBRDF
    report: FitReport | None

    @cached_property
    def decomposition(self) -> Decomposition:
        """The model's components; the first use takes some 0.2 s."""
        return decompose(self.model)

    @cached_property
    def components(self) -> list[dict[str, Any]]:
        """What documents say of the components; the first use computes their albedos."""
        return [component_document(component) for component in self.decomposition]

    @property
    def decomposed(self) -> bool:
        """Whether the components are known already."""
        return "components" in vars(self)


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
        loaded = self._models.setdefault(key, loaded)  # one that has come together with this request is the same
        while len(self._models) > self._size:
            self._models.popitem(last=False)
        return loaded

    async def component(self, key: FitKey, label: str | None, run: Run) -> DSBRDF | Component:
        """Return the model of a fit, or one of its components, which `run` computes at the first use.

        Raises ProblemError as `get`, and if the component has no light.
        """
        if label is None:
            return (await self.get(key)).model
        decomposition = await self.decomposition(key, run)
        if label not in decomposition.labels:
            there = f"it has {' and '.join(decomposition.labels)}" if decomposition.labels else "it reflects no light"
            raise ProblemError("not-found", f"The fit has no component {label}: {there}.")
        return decomposition[label]

    async def decomposition(self, key: FitKey, run: Run) -> Decomposition:
        """Return the components of a fit, whose albedos are known; raises as `get`."""
        return (await self._decomposed(key, run)).decomposition

    async def components(self, key: FitKey, run: Run) -> list[dict[str, Any]]:
        """Return what documents say of the components of a fit; raises as `get`."""
        return (await self._decomposed(key, run)).components

    async def _decomposed(self, key: FitKey, run: Run) -> LoadedFit:
        loaded = await self.get(key)
        if not loaded.decomposed:
            await run(("components", key, id(loaded)), lambda: loaded.components)
        return loaded

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


@dataclass(frozen=True, eq=False)
class FitView:
    """A fit beside its measurement.

    Attributes
    ----------
    exposure : float
        What the radiance of the pictures was multiplied by: that of the measurement, if there is one.
    pictures : dict of str to bytes
        PNG files: ``fit`` and, if the measurement is still stored, ``measured`` and ``difference``.
    measured : ndarray, shape (3, 90, 90), or None
        Mean over phi_diff for each (channel, theta_diff, theta_half) [1/sr]; NaN where there are no data.
    polar : ndarray, shape (lights, viewers, 3), or None
        Measured values in the plane of incidence [1/sr].
    horizon_cutoff : float or None
        Largest angle to the normal of the samples in those means [rad].
    decomposition : Decomposition
        The model and its components, whose values add up to the model's.
    """

    exposure: float
    pictures: dict[str, bytes]
    measured: Array | None
    polar: Array | None
    horizon_cutoff: float | None
    decomposition: Decomposition

    def profile(self, row: int) -> dict[str, Any]:
        """Return curves over theta_half at one row of theta_diff, in JSON's types; values in 1/sr, by channel."""
        measured = None if self.measured is None else self.measured[:, row]
        return {
            "theta_diff_deg": round(float(np.degrees(THETA_DIFF[row])), _DIGITS),
            "node_theta_half_deg": _rounded(np.degrees(THETA_HALF)),
            "measured": None if measured is None else [_rounded(channel) for channel in measured],
            "theta_half_deg": _rounded(np.degrees(_CURVE_ANGLES)),
            **self._of_components(lambda model: slice_means(model, row, self.horizon_cutoff, _CURVE_ANGLES)),
        }

    def plane_of_incidence(self, light: int) -> dict[str, Any]:
        """Return curves over the viewer's angle for one angle of the light [degrees], as `profile` does."""
        measured = None if self.polar is None else self.polar[light // LIGHT_STEP]
        angles = _in_plane(np.array([light]))
        return {
            "theta_in_deg": light,
            "theta_out_deg": _POLAR_ANGLES.tolist(),
            "measured": None if measured is None else [_rounded(channel) for channel in measured.T],
            **self._of_components(lambda model: model.evaluate(*angles)[0]),
        }

    def _of_components(self, values: Callable[[ReflectanceModel], Array]) -> dict[str, Any]:
        """Return curves of the fit and of its components, from what gives the values (n, 3) of a model."""

        def curves(model: ReflectanceModel) -> list[list[float | None]]:
            return [_rounded(channel) for channel in values(model).T]

        components = [{"label": component.label, "values": curves(component)} for component in self.decomposition]
        return {"fit": curves(self.decomposition.model), "components": components}


class FitViews:
    """The views used last, by fit."""

    def __init__(self, store: Store, models: ModelCache) -> None:
        self._store = store
        self._models = models
        self._views: OrderedDict[FitKey, FitView] = OrderedDict()

    async def get(self, row: FitRow, run: Run) -> FitView:
        """Return the view of a fit; raises as `ModelCache.get`.

        `run` makes it, once for all who ask: it takes a core for up to a second, and 200 MB.
        """
        loaded = await self._models.get(row.key)
        view = self._views.get(row.key)
        if view is None or view.decomposition.model is not loaded.model:
            decomposition = await self._models.decomposition(row.key, run)
            view = await run(("view", row.key, id(loaded.model)), lambda: self._make(row, decomposition))
            self._views[row.key] = view
            while len(self._views) > _KEPT:
                self._views.popitem(last=False)
        self._views.move_to_end(row.key)
        return view

    def _make(self, row: FitRow, decomposition: Decomposition) -> FitView:
        cutoff = row.options["horizon_cutoff_deg"]
        horizon_cutoff = None if cutoff is None else float(np.radians(cutoff))
        measurement = self._measurement(row)
        means = polar = None
        if measurement is not None:
            reduced = profiles(measurement, horizon_cutoff=horizon_cutoff)
            means = np.where(reduced.weight > 0.0, reduced.mean, np.nan)
            polar = interpolate(measurement).evaluate(*_in_plane(np.arange(0, LARGEST_LIGHT + 1, LIGHT_STEP)))
        factor, pictures = _pictures(decomposition.model, measurement)
        return FitView(factor, pictures, means, polar, horizon_cutoff, decomposition)

    def _measurement(self, row: FitRow) -> Measurement | None:
        """Return the fit's measurement, unless it has been deleted."""
        try:
            return read_merl(self._store.measurement_file(row.owner, row.measurement))
        except (MeasurementNotFoundError, FileNotFoundError):  # of the file: deleted since its row was read
            return None


def _in_plane(lights: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Half and difference angles of each light and each viewer in one plane with the normal, (lights, viewers)."""
    theta_in, theta_out = np.radians(-lights[:, None]), np.radians(_POLAR_ANGLES)
    omega_in, omega_out = (
        np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1) for theta in (theta_in, theta_out)
    )
    return half_difference(omega_in, omega_out)


def _pictures(model: ReflectanceModel, measurement: Measurement | None) -> tuple[float, dict[str, bytes]]:
    """Return the exposure and the pictures, which all have it."""
    fit = render_sphere(model, size=_SIZE)
    reference = fit if measurement is None else render_sphere(measurement, size=_SIZE)
    factor = exposure(reference, sphere_normals(_SIZE)[1])
    seen = displayed(fit, factor)
    pictures = {"fit": seen}
    if measurement is not None:
        pictures["measured"] = displayed(reference, factor)
        pictures["difference"] = np.clip(DIFFERENCE_GAIN * np.abs(pictures["measured"] - seen), 0.0, 1.0)
    return factor, {name: encode_png(picture) for name, picture in pictures.items()}


def _rounded(values: Array) -> list[float | None]:
    """Return numbers to four digits, as many as a screen can show; None where there is none."""
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]
