"""Represent the components of a model, and divide the model's values among them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array
from dsbrdf.components.description import Description, renderer_layers
from dsbrdf.components.layer_data import data_points, half_of_peak
from dsbrdf.components.layers import LayeredModel, RetroLayer, SheenLayer
from dsbrdf.components.points import NORMAL, LightRule, Points, grid_points
from dsbrdf.components.shares import LABELS, ComponentRanges, Range, WeightedLayers
from dsbrdf.components.surfaces import PROFILE, WIDTH_THETA_HALF, Misfit, OwnValues, Surface
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.findings import Finding
from dsbrdf.model.albedo import directional_albedo
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import ReflectanceModel, check_angle
from dsbrdf.process_settings import one_blas_thread

MIN_COMPONENT_LIGHT = 2e-3
"""A component is left out if it reflects a smaller fraction of all reflected light at every angle."""
MIN_LIGHT_OF_UNLIKELY_COMPONENT = 0.05
"""An unlikely component is left out if it reflects a smaller fraction of all reflected light at every angle."""
_MIN_REMARKED_LIGHT = 0.02
"""A remark names sheen or retro-reflection that has a larger fraction of all reflected light."""
_MAX_CERTAIN_WIDTH = 0.1
"""If the range of the diffuse fraction is wider, that is about 5 % of the light to both sides, a remark says so."""
_MAX_CERTAIN_ABSENT_LIGHT = 0.05
"""Without a diffuse part, a remark says that there may be one with more than this fraction of the light."""
_MIN_ELONGATION = 1.25
"""A remark names a highlight that is wider across the plane of incidence by this factor; round ones reach 1.15."""
_MAX_ELONGATED_HALF_WIDTH = np.radians(10.0)
"""A highlight with a larger half width has no such remark: shadows and the horizon give it another shape."""
_RECEIVERS = {"specular_spike": (1, 2), "specular_lobe": (0, 2), "diffuse": (1, 0)}
"""Indices in `LABELS`, in order of preference, of the component that receives the values of an absent component."""


@dataclass(frozen=True, eq=False, repr=False)
class Component(ReflectanceModel):
    """Evaluate one component of a model, and hold the rough surfaces that describe this component.

    Attributes
    ----------
    label : str
        One of `LABELS`.
    ranges : ComponentRanges
        Ranges of the component's fraction of the light, albedo and colour, each with 90 % probability.
    description : Description
        Layers fitted to the values of the component, and the misfit of these layers.
    whole : Decomposition
        The decomposition that the component belongs to.
    """

    label: str
    ranges: ComponentRanges
    description: Description
    whole: Decomposition

    def __repr__(self) -> str:
        width = "" if self.half_width is None else f", half width {np.degrees(self.half_width):.1f} degrees"
        return f"<Component: {self.label}, {self.light_share:.0%} of the light{width}>"

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (n, 3) [1/sr] at angles (n,) that are not checked, also for directions below the horizon."""
        return self.whole.split_unmasked(theta_half, theta_diff, phi_diff)[self._index]

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield for each theta_diff the values (3, H, P) [1/sr] at all pairs of theta_half (H,) and phi_diff (P,)."""
        for parts in self.whole.split_grid(theta_half, theta_diff, phi_diff):
            yield parts[self._index]

    def directional_albedo(self, theta_out: ArrayLike) -> Array:
        """Return the fraction (..., 3) of light from directions theta_out (...) [rad] that the component reflects."""
        return directional_albedo(self.evaluate_unmasked, check_angle("theta_out", theta_out))

    @property
    def layers(self) -> LayeredModel:
        """Layers fitted to the component's own values."""
        return self.description.layers

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """At most two rough surfaces of a specular component, the brightest first; empty for a diffuse component."""
        return self.description.surfaces

    @property
    def misfit(self) -> Misfit:
        """Distance of the layers in `layers` from the values of the component."""
        return self.description.misfit

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences about parameters that are None, because no surface describes the component or F70 is uncertain."""
        return self.description.remarks(self.label)

    def height(self, theta_diff: ArrayLike) -> Array:
        """Return values (..., 3) [1/sr] of the component's layers at theta_half = 0 and theta_diff (...) [rad]."""
        theta_diff = check_angle("theta_diff", theta_diff)
        flat = theta_diff.ravel()
        values = self.layers.evaluate_unmasked(np.zeros(flat.size), flat, np.full(flat.size, np.pi / 2))
        return values.reshape(*theta_diff.shape, 3)

    @property
    def structure(self) -> str:
        """The most probable structure that has the component, in words, such as "dielectric over diffuse".

        The width of the mean over all structures names a single highlight, as a spike or as a lobe. If no structure has
        this name, this is the most probable structure.
        """
        structures = self.whole.structures
        return next((one for one in structures if self.label in one.labels), structures[0]).name

    @property
    def albedo(self) -> Array:
        """Directional albedo at normal incidence, RGB, shape (3,)."""
        return self.whole.albedos[self._index]

    @property
    def light_share(self) -> float:
        """Fraction of the model's light, channels added, that the component reflects at normal incidence."""
        return float(self.albedo.sum() / self.whole.albedos.sum())

    @property
    def color(self) -> Array:
        """Albedo divided by its largest channel, RGB, shape (3,)."""
        return np.asarray(self.albedo / (self.albedo.max() or 1.0))

    @property
    def half_width(self) -> float | None:
        """Angle theta_half at which slopes of the surfaces are half as frequent as the slope 0 [rad], or None."""
        return self.description.half_width

    @property
    def _index(self) -> int:
        return self.whole.labels.index(self.label)


@dataclass(frozen=True, eq=False, repr=False)
class Decomposition:
    """The components of a model that reflect light; their values sum to the model's values.

    Iteration yields the components from narrow to wide; ``decomposition[label]`` returns one component.

    Attributes
    ----------
    model : DSBRDF
        The model that was decomposed.
    structures : tuple of WeightedLayers
        Structures of layers that explain the model, the most probable one first; the weights sum to 1.
    labels : tuple of str
        Labels of the components that reflect light, in the order of `LABELS`.
    ranges : tuple of ComponentRanges
        Ranges of the light and colour of each component.
    descriptions : tuple of Description
        Layers fitted to the values of each component.
    diffuse_range : tuple of float
        Range with 90 % probability of the diffuse fraction of all light, also without a diffuse component.
    alternatives : tuple of str
        Names of structures that widen the ranges without taking part in the split.
    """

    model: DSBRDF
    structures: tuple[WeightedLayers, ...]
    labels: tuple[str, ...]
    ranges: tuple[ComponentRanges, ...]
    descriptions: tuple[Description, ...]
    diffuse_range: Range
    alternatives: tuple[str, ...]

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
        """The highlight whose half width is below 3 degrees, or None if there is none."""
        return self._find("specular_spike")

    @property
    def specular_lobe(self) -> Component | None:
        """The highlight whose half width is 3 degrees or more, or None if there is none."""
        return self._find("specular_lobe")

    @property
    def diffuse(self) -> Component | None:
        """The component that is reflected into all directions, or None if there is none."""
        return self._find("diffuse")

    @property
    def structure(self) -> str:
        """The most probable structure in words, such as "dielectric over diffuse", or "no light"."""
        return self.structures[0].name if self.structures else "no light"

    @cached_property
    @one_blas_thread
    def layers(self) -> LayeredModel:
        """A small model of the material for renderers: the layers of all components, fitted together."""
        return renderer_layers(self.model.evaluate_unmasked, self.descriptions)

    @cached_property
    def albedos(self) -> Array:
        """Directional albedo of each component at normal incidence, shape (components, 3)."""
        return np.sum(self.split_at(NORMAL) * NORMAL.weight, axis=2)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about an undetermined diffuse fraction, withheld parameters, an elongated highlight, other light."""
        own = (remark for component in self for remark in component.description.misfit_remarks(component.label))
        withheld = (Finding("withheld", remark) for remark in own)
        return (*self._open_split(), *withheld, *self._elongated(), *self._other_light())

    @property
    def remarks(self) -> tuple[str, ...]:
        """The sentences of the `findings`."""
        return tuple(finding.sentence for finding in self.findings)

    def receiver(self, label: str) -> str:
        """Return the label of the component to which layers with some label belong, also if theirs is left out."""
        return next(one for one in (label, *(LABELS[heir] for heir in _RECEIVERS[label])) if one in self.labels)

    def received(self, label: str) -> tuple[str, ...]:
        """Return the labels of all layers that belong to the component with a label."""
        return tuple(one for one in LABELS if self.receiver(one) == label)

    def split_at(self, rule: LightRule) -> Array:
        """Return the values of all components at the n nodes of a quadrature [1/sr], (components, 3, n)."""
        return self._split(self.model.evaluate_unmasked(*rule.angles).T, rule.points)

    def own_values(self, on_grid: Array, reflected: Sequence[Array]) -> tuple[OwnValues, ...]:
        """Return for each component the values to which layers are fitted.

        `on_grid` has the values of the model at the points of `data_points`, (3, N), and `reflected` the albedos of
        `LABELS` at each angle of `light_rules`.
        """
        grids = self._split(on_grid, data_points())
        profiles = self.split_unmasked(*PROFILE).transpose(0, 2, 1)
        albedos = np.stack([self._received(light) for light in reflected], axis=1)
        return tuple(OwnValues(*own) for own in zip(grids, profiles, albedos, strict=True))

    def split_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (components, n, 3) [1/sr] of all components at angles (n,) that are not checked."""
        values = self.model.evaluate_unmasked(theta_half, theta_diff, phi_diff)
        return self._split(values.T, Points.at(theta_half, theta_diff, phi_diff)).transpose(0, 2, 1)

    def split_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield for each theta_diff the values (components, 3, H, P) at all theta_half (H,) and phi_diff (P,)."""
        axes = theta_half, theta_diff, phi_diff
        for points, values in zip(grid_points(*axes), self.model.evaluate_grid(*axes), strict=True):
            yield self._split(values.reshape(3, -1), points).reshape(-1, *values.shape)

    def _split(self, values: Array, points: Points) -> Array:
        """Divide values (3, N) of the model at points among the components, (components, 3, N)."""
        if len(self.labels) < 2:
            return values[np.newaxis][: len(self.labels)]
        parts = np.sum([one.weight * one.split(values, points) for one in self.structures], axis=0)
        return self._received(parts)

    def _received(self, parts: Array) -> Array:
        """Return the values of all components; a component receives the values of labels that are left out."""
        received = parts.copy()
        for place, label in enumerate(LABELS):
            if label not in self.labels:
                received[LABELS.index(self.receiver(label))] += parts[place]
        return np.asarray(received[[LABELS.index(label) for label in self.labels]])

    def _open_split(self) -> Iterator[Finding]:
        low, high = self.diffuse_range
        found = 0.0 if self.diffuse is None else self.diffuse.light_share
        is_doubtful = low < MIN_COMPONENT_LIGHT and found > MIN_LIGHT_OF_UNLIKELY_COMPONENT
        may_be_missing = found < MIN_COMPONENT_LIGHT and high > _MAX_CERTAIN_ABSENT_LIGHT
        if high - low > _MAX_CERTAIN_WIDTH or is_doubtful or may_be_missing:
            names = ", ".join(f"{structure.name} {structure.weight:.0%}" for structure in self.structures[:3])
            yield Finding(
                "open-split",
                f"The measurement does not determine how much of the light is diffuse: it may be {low:.0%} to "
                f"{high:.0%}. Probable structures: {names}."
                + "".join(f" A material of another structure looks alike: {name}." for name in self.alternatives),
                {"low": low, "high": high},
            )

    def _elongated(self) -> Iterator[Finding]:
        """Yield a finding if the highlights together are wider across the plane of incidence than along it."""
        highlights = [place for place, label in enumerate(self.labels) if label != LABELS[2]]
        theta_half, theta_diff = WIDTH_THETA_HALF, np.full(WIDTH_THETA_HALF.size, np.radians(30.0))
        along, across = (
            half_of_peak(self.split_unmasked(theta_half, theta_diff, phi)[highlights].sum(axis=(0, 2)), theta_half)
            for phi in (np.zeros(theta_diff.size), np.full(theta_diff.size, np.pi / 2))
        )
        ratio = across / along
        if along < _MAX_ELONGATED_HALF_WIDTH and ratio > _MIN_ELONGATION:
            yield Finding(
                "elongated-highlight",
                f"The highlight is {ratio:.1f} times as wide across the plane of incidence as along it, as if the "
                "surface had a grain: alpha and the half width lie between both. Turn the sample by 90 degrees and "
                "measure it again; an isotropic material stays the same.",
                {"ratio": ratio},
            )

    def _other_light(self) -> Iterator[Finding]:
        kinds = (
            (RetroLayer, "retro-reflection", "goes back towards its source; it is counted with the specular lobe"),
            (SheenLayer, "sheen", "is sheen, as of fibres at grazing angles; it is counted as diffuse"),
        )
        for kind, code, what in kinds:
            share = sum(structure.weight * structure.light_of(kind) for structure in self.structures)
            if share > _MIN_REMARKED_LIGHT:
                yield Finding(code, f"About {share:.0%} of the light {what}.", {"fraction": share})

    def _find(self, label: str) -> Component | None:
        return self[label] if label in self.labels else None

    @cached_property
    def _components(self) -> tuple[Component, ...]:
        parts = zip(self.labels, self.ranges, self.descriptions, strict=True)
        return tuple(Component(label, ranges, found, self) for label, ranges, found in parts)
