"""Specular spike, specular lobe and diffuse part of a model: readable lobes, and what share of the model is whose.

The lobes of an accurate model lean on each other and cannot be told apart into components. The `guide`'s can: it is
fitted to the model's own values, so that any model has a decomposition. With the guide's lobes g_j, their sum g, and
s_j = g_j / g, the components of a model f are

    diffuse = min(f, g_d (1 + (f / g - 1) w)),      specular_j = (f - diffuse) g_j / (g - g_d),

with w = s_d**3 q / (1 + q) and q = (tan(theta_half) / tan(8 degrees))**4. Where the highlight rules, s_d = 0 and the
diffuse part is the guide's, smooth; where the diffuse part rules, s_d = 1, it is all of f; but about the mirror
direction, where q is small, what the guide misses is a halo of the highlight. The components sum to f, and none is
negative. A component is there only if it has light.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.guide import FAMILY, SPIKE_HALF_WIDTH, TYPICAL_ANGLES, fit_guide, guide_data
from dsbrdf.fitting.structure import mixture_model
from dsbrdf.model.albedo import directional_albedo, half_vector_rule
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import half_width
from dsbrdf.model.reflectance import ReflectanceModel, check_angle
from dsbrdf.process_settings import one_blas_thread

if TYPE_CHECKING:
    from dsbrdf.fitting.report import FitResult

LABELS = ("specular_spike", "specular_lobe", "diffuse")
"""Components, from narrow to wide."""
_TRANSITION = 3  # power of the diffuse part's share with which it takes what the guide misses
HALO = float(np.tan(np.radians(8.0))) ** 2
"""tan(theta_half)**2 up to which most of what the guide misses is the highlight's."""
_NO_LIGHT = 1e-3  # of the light at an angle
_LIGHT_ANGLES = np.radians([0.0, 40.0, 70.0])
_TINY = 1e-300


@dataclass(frozen=True)
class LobeParameters:
    """The readable lobe of a component at angles theta_diff of shape (...).

    The tail is the exponent kappa: 2 is GGX, smaller ones have longer tails, 10 is nearly Gaussian. The elongation 0 is
    round about the half vector, 1 is stretched by 1 / cos(theta_diff), as highlights at grazing angles are.
    """

    height: Array  # red, green and blue at theta_half = 0 [1/sr], (..., 3)
    half_width: Array  # theta_half of half the height, where phi_diff stretches it neither way [rad]
    tail: Array
    elongation: Array


@dataclass(frozen=True, eq=False, repr=False)
class Component(ReflectanceModel):
    """One component: its share of the values of a model, and a lobe that a person can read.

    Attributes
    ----------
    label : str
        One of `LABELS`.
    lobe, whole : DSBRDF, Decomposition
        The component's own lobe in the guide, its values if the guide were exact; and what it is a part of.
    """

    label: str
    lobe: DSBRDF
    whole: Decomposition

    def __repr__(self) -> str:
        return f"<Component: {self.label}, half width {np.degrees(self.half_width):.1f} degrees>"

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Values of the formula (n, 3) for angles (n,) that are not checked, below the horizon too [1/sr]."""
        return self.whole.split_unmasked(theta_half, theta_diff, phi_diff)[self._index]

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield the formula's values (3, D, P) at each angle theta_half (H,) for all theta_diff (D,), phi_diff (P,)."""
        for parts in self.whole.split_grid(theta_half, theta_diff, phi_diff):
            yield parts[self._index]

    def parameters_at(self, theta_diff: ArrayLike) -> LobeParameters:
        """Height, half width, tail and elongation of the component's own lobe at angles theta_diff (...) [rad]."""
        at = self.lobe.parameters_at(theta_diff)
        kappa, gamma = at["kappa"][..., 0, 0], at["gamma"][..., 0, 0]
        return LobeParameters(
            at["amplitude"][..., 0], half_width(kappa, gamma, FAMILY), kappa, at["elongation"][..., 0]
        )

    def directional_albedo(self, theta_out: ArrayLike) -> Array:
        """Share of the light from each direction theta_out (...) [rad] that the component reflects, shape (..., 3)."""
        return directional_albedo(self.evaluate_unmasked, check_angle("theta_out", theta_out))

    @property
    def albedo(self) -> Array:
        """Directional albedo at normal incidence, RGB, shape (3,)."""
        return self.whole.albedos[self._index]

    @property
    def color(self) -> Array:
        """The albedo over its largest channel, RGB, shape (3,)."""
        return np.asarray(self.albedo / (self.albedo.max() or 1.0))

    @property
    def half_width(self) -> float:
        """Half width of the component's own lobe [rad]: the median over theta_diff from 0 to 60 degrees."""
        return float(np.median(self.parameters_at(TYPICAL_ANGLES).half_width))

    @property
    def clarity(self) -> float:
        """How clear the split is: the share that the component has of all light where it shines itself, 0 to 1.

        Near 1 nothing else shines there; at 0.5 as much light of other components does, and a small change of the
        measurement can move light from one to the other.
        """
        return float(self.whole.clarities[self._index])

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
    guide : DSBRDF
        The components' own lobes together, in the order of the labels: a model of 35 numbers a lobe.
    labels : tuple of str
        Of the components that have light, in the order of `LABELS`.
    """

    model: DSBRDF
    guide: DSBRDF
    labels: tuple[str, ...]

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

    @cached_property
    def albedos(self) -> Array:
        """Directional albedo of each component at normal incidence, shape (K, 3)."""
        return np.asarray(np.einsum("n,knc->kc", _NORMAL.weight, self._at_normal))

    @cached_property
    def clarities(self) -> Array:
        """Clarity of each component, see `Component.clarity`, shape (K,)."""
        light = self._at_normal.sum(axis=2)
        share = light / (light.sum(axis=0) + _TINY)
        return np.asarray(((share * light) @ _NORMAL.weight) / (light @ _NORMAL.weight + _TINY))

    def split_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Values of all components (K, n, 3) for angles (n,) that are not checked [1/sr]."""
        angles = theta_half, theta_diff, phi_diff
        guides = [component.lobe.evaluate_unmasked(*angles) for component in self]
        return self._shares(self.model.evaluate_unmasked(*angles), guides, theta_half[:, np.newaxis])

    def split_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield the values of all components (K, 3, D, P) at each theta_half (H,), as `DSBRDF.evaluate_grid`."""
        axes = theta_half, theta_diff, phi_diff
        lobes = (component.lobe.evaluate_grid(*axes) for component in self)
        for angle, values, *guides in zip(theta_half, self.model.evaluate_grid(*axes), *lobes, strict=True):
            yield self._shares(values, guides, angle)

    def _shares(self, values: Array, guides: list[Array], theta_half: Array) -> Array:
        """Divide values (...) among the components by their guides' lobes (...) each, shape (K, ...)."""
        if len(guides) < 2:
            return values[np.newaxis][: len(guides)]
        parts = np.stack(guides)
        if self.labels[-1] == "diffuse":
            total = parts.sum(axis=0) + _TINY
            taken = (parts[-1] / total) ** _TRANSITION * (1.0 - 1.0 / (1.0 + (np.tan(theta_half) ** 2 / HALO) ** 2))
            parts[-1] = np.minimum(values, parts[-1] * (1.0 + (values / total - 1.0) * taken))
            specular, rest = parts[:-1], values - parts[-1]
        else:
            specular, rest = parts, values
        if len(specular) == 1:
            specular[0] = rest
            return parts
        narrow = specular[0] / (specular.sum(axis=0) + _TINY)
        specular[0] = rest * narrow
        specular[1] = rest - specular[0]
        return parts

    def _find(self, label: str) -> Component | None:
        return self[label] if label in self.labels else None

    @cached_property
    def _components(self) -> tuple[Component, ...]:
        lobes = (self.guide.select((index,), with_delta=False) for index in range(len(self.labels)))
        return tuple(Component(label, lobe, self) for label, lobe in zip(self.labels, lobes, strict=True))

    @cached_property
    def _at_normal(self) -> Array:
        """Values of all components at the nodes of `_NORMAL`, shape (K, n, 3)."""
        return self.split_unmasked(_NORMAL.theta_half, _NORMAL.theta_diff, _NORMAL.phi_diff)


_NORMAL = half_vector_rule(0.0)


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
    data = guide_data(model)
    if data.signal == 0.0:
        return Decomposition(model, model.select((), with_delta=False), ())
    guide = fit_guide(data)
    narrowest, *others = guide.half_widths
    labels = LABELS if len(others) == 2 else (LABELS[0 if narrowest < SPIKE_HALF_WIDTH else 1], LABELS[2])
    lobes = mixture_model(guide.mixture)
    lit = [k for k, light in enumerate(_light(lobes).T) if light.max() > _NO_LIGHT]
    return Decomposition(model, lobes.select(tuple(lit), with_delta=False), tuple(labels[k] for k in lit))


def _light(model: DSBRDF) -> Array:
    """Share of each lobe in the light at some angles, shape (angles, K)."""
    lobes = [model.select((k,), with_delta=False) for k in range(model.n_lobes)]
    light = np.stack([lobe.albedo(_LIGHT_ANGLES).sum(axis=-1) for lobe in lobes], axis=1)
    return np.asarray(light / (light.sum(axis=1, keepdims=True) + _TINY))
