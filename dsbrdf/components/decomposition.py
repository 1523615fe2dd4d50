"""Specular spike, specular lobe and diffuse part of a model: physical layers, and what share of the model is whose.

The lobes of an accurate model lean on each other and cannot be told apart into components. Physical layers can: some
structures of them are fitted to the model's own values and weighed by their evidence
(`dsbrdf.components.layer_fit`), so that any model has a decomposition. In a structure with the diffuse light d of g,
the sum of all layers, the diffuse part of a model f is

    min(f, d (1 + (f / g - 1) w)),      w = (d / g)**3 (f < g ? 1 : q / (1 + q)),
    q = (tan(theta_half) / tan(30 degrees))**4.

Where the highlight rules it is the layers' own, smooth; where the diffuse part rules it is all of f; but about the
mirror direction, where q is small, light that the layers lack is a halo of the highlight. Where there is a ground
alone, it has at most d (2 + q). What is left is the highlights', by the light of their layers. A component has the
mean over the structures, by weight: components sum to f, none is negative, and the split hangs on no threshold. A
component is there only if it has light.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array
from dsbrdf.components.layer_data import layer_data
from dsbrdf.components.layer_fit import fit_structures, structure_weights
from dsbrdf.components.layers import LayeredModel, RetroLayer, SheenLayer, SpecularLayer
from dsbrdf.components.points import Points, grid_points
from dsbrdf.components.ranges import ComponentRanges, component_ranges
from dsbrdf.components.shares import LABELS, NORMAL, WeightedLayers
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.albedo import directional_albedo, half_vector_rule
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import ReflectanceModel, check_angle
from dsbrdf.process_settings import one_blas_thread

if TYPE_CHECKING:
    from dsbrdf.fitting.report import FitResult

_LEAST_WEIGHT = 0.01  # of a structure that is kept
_NO_LIGHT = 2e-3  # of the light at an angle
_FAINT, _PROBABLE = 0.02, 0.5  # share of the light at an angle, weight of the structures
_LIGHT_ANGLES = np.radians([0.0, 40.0, 70.0])
_WORTH_A_WORD = 0.02  # of the light, of sheen and of light back towards the source
_OPEN = 0.2  # width of a range of the diffuse share above which the split is open
_HEIRS = {"specular_spike": (1, 2), "specular_lobe": (0, 2), "diffuse": (1, 0)}
"""Places of the components that take what a component without light has, the first of them that is there."""


@dataclass(frozen=True, eq=False, repr=False)
class Component(ReflectanceModel):
    """One component: its share of the values of a model, and the parameters of its brightest layer.

    Attributes
    ----------
    label : str
        One of `LABELS`.
    ranges : ComponentRanges
        Where its figures lie with 90 % probability.
    whole : Decomposition
        What it is a part of.
    """

    label: str
    ranges: ComponentRanges
    whole: Decomposition

    def __repr__(self) -> str:
        width = "" if self.half_width is None else f", half width {np.degrees(self.half_width):.1f} degrees"
        return f"<Component: {self.label}, {self.light_share:.0%} of the light{width}>"

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Values of the formula (n, 3) for angles (n,) that are not checked, below the horizon too [1/sr]."""
        return self.whole.split_unmasked(theta_half, theta_diff, phi_diff)[self._index]

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield the formula's values (3, D, P) at each angle theta_half (H,) for all theta_diff (D,), phi_diff (P,)."""
        for parts in self.whole.split_grid(theta_half, theta_diff, phi_diff):
            yield parts[self._index]

    def directional_albedo(self, theta_out: ArrayLike) -> Array:
        """Share of the light from each direction theta_out (...) [rad] that the component reflects, shape (..., 3)."""
        return directional_albedo(self.evaluate_unmasked, check_angle("theta_out", theta_out))

    @property
    def layers(self) -> LayeredModel:
        """The component's own layers, in the most probable structure that has some."""
        found = self._structure
        own = (layer for layer, label in zip(found.model.layers, found.labels, strict=True) if label == self.label)
        return LayeredModel(tuple(own))

    def height(self, theta_diff: ArrayLike) -> Array:
        """Values of the component's own layers at theta_half = 0 and angles theta_diff (...) [rad], (..., 3) [1/sr]."""
        theta_diff = check_angle("theta_diff", theta_diff)
        flat = theta_diff.ravel()
        values = self.layers.evaluate_unmasked(np.zeros(flat.size), flat, np.full(flat.size, np.pi / 2))
        return values.reshape(*theta_diff.shape, 3)

    @property
    def structure(self) -> str:
        """The most probable structure that has the component, in words, such as "dielectric over diffuse"."""
        return self._structure.name

    @property
    def layer(self) -> SpecularLayer | RetroLayer | None:
        """The brightest layer of a specular component, in the most probable structure that has one; None if diffuse."""
        layer = self._structure.brightest(self.label)
        return layer if isinstance(layer, (SpecularLayer, RetroLayer)) and self.label != "diffuse" else None

    @property
    def alpha(self) -> float | None:
        """Roughness of the layer; None if diffuse."""
        return None if self.layer is None else self.layer.alpha

    @property
    def kappa(self) -> float | None:
        """Exponent of the layer's tails, 2 for GGX; None if it is no surface."""
        return self.layer.kappa if isinstance(self.layer, SpecularLayer) else None

    @property
    def f0(self) -> Array | None:
        """Reflectance at normal incidence of the component's surfaces together, RGB, shape (3,); None without any."""
        return self._structure.reflectance(self.label) if isinstance(self.layer, SpecularLayer) else None

    @property
    def f90(self) -> float | None:
        """Reflectance of the layer at grazing incidence; None if it is no surface."""
        return self.layer.f90 if isinstance(self.layer, SpecularLayer) else None

    @property
    def albedo(self) -> Array:
        """Directional albedo at normal incidence, RGB, shape (3,)."""
        return self.whole.albedos[self._index]

    @property
    def light_share(self) -> float:
        """Share of all light, channels added, that the component reflects at normal incidence."""
        return float(self.albedo.sum() / self.whole.albedos.sum())

    @property
    def color(self) -> Array:
        """The albedo over its largest channel, RGB, shape (3,)."""
        return np.asarray(self.albedo / (self.albedo.max() or 1.0))

    @property
    def half_width(self) -> float | None:
        """Angle theta_half at which the slopes of the layer are half as frequent as at 0 [rad]; None if diffuse."""
        return None if self.layer is None else self.layer.half_width

    @property
    def _structure(self) -> WeightedLayers:
        return next(s for s in self.whole.structures if self.label in s.labels)

    @property
    def _index(self) -> int:
        return self.whole.labels.index(self.label)


@dataclass(frozen=True, eq=False, repr=False)
class Decomposition:
    """The components of a model that have light; their values sum to the model's.

    Iterating yields them from narrow to wide; ``decomposition[label]`` looks one up.

    Attributes
    ----------
    model : DSBRDF
        What was decomposed.
    structures : tuple of WeightedLayers
        Structures of layers that explain the model, the most probable one first; the weights sum to 1.
    labels : tuple of str
        Of the components that have light, in the order of `LABELS`.
    ranges : tuple of ComponentRanges
        Of each component.
    """

    model: DSBRDF
    structures: tuple[WeightedLayers, ...]
    labels: tuple[str, ...]
    ranges: tuple[ComponentRanges, ...]

    def __repr__(self) -> str:
        return f"<Decomposition: {', '.join(self.labels) or 'no light'}>"

    def __iter__(self) -> Iterator[Component]:
        return iter(self._components)

    def __len__(self) -> int:
        return len(self.labels)

    def __getitem__(self, label: str) -> Component:
        if label not in LABELS:
            raise InvalidArgumentError(f"the label must be one of {', '.join(LABELS)}, not {label!r}")
        if label not in self.labels:
            there = f"it has {' and '.join(self.labels)}" if self.labels else "it has no light"
            raise InvalidArgumentError(f"this model has no component {label}: {there}")
        return self._components[self.labels.index(label)]

    @property
    def specular_spike(self) -> Component | None:
        """The highlight narrower than 3 degrees; None if there is none."""
        return self._find("specular_spike")

    @property
    def specular_lobe(self) -> Component | None:
        """The highlight of 3 degrees and more; None if there is none."""
        return self._find("specular_lobe")

    @property
    def diffuse(self) -> Component | None:
        """What is reflected into all directions; None if it has no light."""
        return self._find("diffuse")

    @property
    def structure(self) -> str:
        """The most probable structure in words, such as "dielectric over diffuse"; "no light" if there is none."""
        return self.structures[0].name if self.structures else "no light"

    @property
    def layers(self) -> LayeredModel:
        """The layers of the most probable structure: a small model that looks much like the material."""
        return self.structures[0].model if self.structures else LayeredModel(())

    @cached_property
    def albedos(self) -> Array:
        """Directional albedo of each component at normal incidence, shape (K, 3)."""
        values = self.model.evaluate_unmasked(NORMAL.angle, NORMAL.angle, np.zeros(NORMAL.angle.size))
        return np.asarray(self._split(values.T, NORMAL.points) @ NORMAL.weight)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences about a split that is open, and about light that no component stands for."""
        return (*self._open_split(), *self._other_light())

    def receiver(self, label: str) -> str:
        """Label of the component that has what the layers with a label reflect: its own, or the heir of one without."""
        return next(one for one in (label, *(LABELS[heir] for heir in _HEIRS[label])) if one in self.labels)

    def split_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Values of all components (K, n, 3) for angles (n,) that are not checked [1/sr]."""
        values = self.model.evaluate_unmasked(theta_half, theta_diff, phi_diff)
        return self._split(values.T, Points.at(theta_half, theta_diff, phi_diff)).transpose(0, 2, 1)

    def split_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield the values of all components (K, 3, D, P) at each theta_half (H,), as `DSBRDF.evaluate_grid`."""
        axes = theta_half, theta_diff, phi_diff
        for points, values in zip(grid_points(*axes), self.model.evaluate_grid(*axes), strict=True):
            yield self._split(values.reshape(3, -1), points).reshape(-1, *values.shape)

    def _split(self, values: Array, points: Points) -> Array:
        """Divide values (3, N) at points among the components, shape (K, 3, N)."""
        if len(self.labels) < 2:
            return values[np.newaxis][: len(self.labels)]
        parts = np.sum([one.weight * one.split(values, points) for one in self.structures], axis=0)
        for place, label in enumerate(LABELS):
            if label not in self.labels:
                parts[LABELS.index(self.receiver(label))] += parts[place]
        return np.asarray(parts[[LABELS.index(label) for label in self.labels]])

    def _open_split(self) -> Iterator[str]:
        if not self.labels:
            return
        low, high = 0.0, 1.0 - sum(part.ranges.light_share[0] for part in self)
        if self.diffuse is not None:
            low, high = self.diffuse.ranges.light_share
        is_doubtful = self.diffuse is not None and low < _NO_LIGHT and self.diffuse.light_share > _FAINT
        if high - low > _OPEN or is_doubtful:
            names = ", ".join(f"{structure.name} {structure.weight:.0%}" for structure in self.structures[:3])
            yield (
                f"The split into specular and diffuse light is open: the diffuse part has {low:.0%} to {high:.0%} of "
                f"the light. Probable structures: {names}."
            )

    def _other_light(self) -> Iterator[str]:
        kinds = (
            (RetroLayer, "goes back towards its source; it is counted with the specular lobe"),
            (SheenLayer, "is sheen, as of fibres at grazing angles; it is counted as diffuse"),
        )
        for kind, what in kinds:
            share = sum(structure.weight * structure.light_of(kind) for structure in self.structures)
            if share > _WORTH_A_WORD:
                yield f"About {share:.0%} of the light {what}."

    def _find(self, label: str) -> Component | None:
        return self[label] if label in self.labels else None

    @cached_property
    def _components(self) -> tuple[Component, ...]:
        return tuple(Component(label, found, self) for label, found in zip(self.labels, self.ranges, strict=True))


def decompose(model: DSBRDF | FitResult) -> Decomposition:
    """Separate a model into specular spike, specular lobe and diffuse part.

    Parameters
    ----------
    model : DSBRDF or FitResult
        Any model: of a fit, loaded, of the paper's method.

    Returns
    -------
    Decomposition
        Components that sum to the model; kept for the last models asked for.
    """
    return _decompose(getattr(model, "model", model))


@lru_cache(maxsize=32)
@one_blas_thread
def _decompose(model: DSBRDF) -> Decomposition:
    data = layer_data(model)
    if data is None:
        return Decomposition(model, (), (), ())
    found = fit_structures(data)
    kept = [one for one, weight in zip(found, structure_weights(found), strict=True) if weight >= _LEAST_WEIGHT]
    structures = tuple(
        WeightedLayers(one.structure.name, float(weight), one.model, one.structure.is_diffuse)
        for one, weight in zip(kept, structure_weights(kept), strict=True)
    )
    light = np.max([_light(model, structures, angle) for angle in _LIGHT_ANGLES.tolist()], axis=0)
    shares = dict(zip(LABELS, light.tolist(), strict=True))
    labels = tuple(label for label in LABELS if _is_there(label, shares[label], structures))
    # Light that no layer explains, such as a delta term alone, is that of the most probable structure.
    labels = labels or (structures[0].labels[-1],)
    return Decomposition(model, structures, labels, component_ranges(model, kept, labels))


def _is_there(label: str, share: float, structures: tuple[WeightedLayers, ...]) -> bool:
    """Whether a component with a share of the light is there: a faint one must be probable too."""
    probability = sum(structure.weight for structure in structures if label in structure.labels)
    return probability > 0.0 and share > (_NO_LIGHT if probability > _PROBABLE else _FAINT)


def _light(model: DSBRDF, structures: tuple[WeightedLayers, ...], theta_out: float) -> Array:
    """Share of each of `LABELS` in the light at an angle [rad], shape (3,)."""
    rule = half_vector_rule(theta_out)
    angles = rule.theta_half, rule.theta_diff, rule.phi_diff
    values, points = model.evaluate_unmasked(*angles).T, Points.at(*angles)
    parts = np.sum([one.weight * one.split(values, points) for one in structures], axis=0)
    light = np.sum(parts @ rule.weight, axis=1)
    return np.asarray(light / max(float(light.sum()), 1e-300))
