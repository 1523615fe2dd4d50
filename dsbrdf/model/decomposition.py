"""Which lobes are the specular spike, the specular lobe and the diffuse part.

A lobe is labelled by how far it reaches from the normal, not by its index: a spike is as narrow as the instrument's and
the coating's spread, a diffuse part is wide.  Its reach at one theta_diff is the largest theta' at which it has half of
its height.  One label holds for a lobe over all theta_diff.

Lobes whose reaches are close describe one peak and belong together, so that the border between two components is the
widest gap between reaches near a threshold, not the threshold itself: a small change of the data does not move a lobe
across it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import lobe_values

Array = NDArray[np.float64]

LABELS = ("specular_spike", "specular_lobe", "diffuse")
"""Components, from narrow to wide."""
SPIKE_HALF_WIDTH = float(np.radians(3.0))
"""Border between the specular spike and the specular lobe, where no gap decides [rad of theta_half]."""
DIFFUSE_HALF_WIDTH = float(np.radians(25.0))
"""Border between the specular lobe and the diffuse part, where no gap decides [rad of theta_half]."""
_GAP_RANGE = 1.8  # a border may move from a threshold by this factor
_ANGLES = np.radians(np.arange(0.0, 81.0, 5.0))
_REACHES = np.concatenate([[0.0], np.geomspace(np.radians(0.02), np.pi / 2, 300)])


@dataclass(frozen=True, eq=False)
class Component:
    """One component: the lobes of a model that carry its label.

    Attributes
    ----------
    label : str
        One of `LABELS`.
    model : DSBRDF
        Made of the component's lobes.
    lobes : tuple of int
        Their indices in the model that was decomposed.
    half_width : float or None
        Largest theta_half at which the component has half of its height, at theta_diff = 0 [rad]; None without lobes.
    margin : float or None
        How clear the split is: ``abs(log2(ratio))`` of the nearest border and the nearest reach of a lobe.  At 1 the
        lobe is twice as wide or as narrow, at 0 it lies on the border.  None without lobes.
    """

    label: str
    model: DSBRDF
    lobes: tuple[int, ...]
    half_width: float | None
    margin: float | None

    @cached_property
    def albedo(self) -> Array:
        """Directional albedo at normal incidence, RGB, shape (3,)."""
        return self.model.albedo(0.0)

    def evaluate(self, theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike = np.pi / 2) -> Array:
        """Values of the component, see `DSBRDF.evaluate`."""
        return self.model.evaluate(theta_half, theta_diff, phi_diff)

    def evaluate_directions(self, omega_in: ArrayLike, omega_out: ArrayLike) -> Array:
        """Values of the component, see `DSBRDF.evaluate_directions`."""
        return self.model.evaluate_directions(omega_in, omega_out)


@dataclass(frozen=True, eq=False)
class Decomposition:
    """The three components of a model; their values sum to the model's.

    Iterating yields them in the order of `LABELS`; ``decomposition[label]`` looks one up.
    """

    specular_spike: Component
    specular_lobe: Component
    diffuse: Component

    def __iter__(self) -> Iterator[Component]:
        return iter((self.specular_spike, self.specular_lobe, self.diffuse))

    def __getitem__(self, label: str) -> Component:
        if label not in LABELS:
            raise InvalidArgumentError(f"the label must be one of {', '.join(LABELS)}, not {label!r}")
        component: Component = getattr(self, label)
        return component


def decompose(
    model: DSBRDF,
    *,
    spike_half_width: float = SPIKE_HALF_WIDTH,
    diffuse_half_width: float = DIFFUSE_HALF_WIDTH,
) -> Decomposition:
    """Group the lobes of a model into specular spike, specular lobe and diffuse part.

    Parameters
    ----------
    model : DSBRDF or FitResult
    spike_half_width, diffuse_half_width : float, optional
        Thresholds on the reach of a lobe [rad of theta_half].

    Returns
    -------
    Decomposition
        Components that sum to the model.  The delta term belongs to the spike.

    Raises
    ------
    InvalidArgumentError
        Unless 0 < spike_half_width < diffuse_half_width <= pi/2.
    """
    model = getattr(model, "model", model)
    if not 0.0 < spike_half_width < diffuse_half_width <= np.pi / 2:
        raise InvalidArgumentError(
            "the half width thresholds must satisfy 0 < spike_half_width < diffuse_half_width <= pi/2"
        )
    widths = lobe_widths(model)
    borders = np.array([_border(widths, threshold) for threshold in (spike_half_width, diffuse_half_width)])
    groups = np.searchsorted(borders, widths, side="right")
    components = []
    for group, label in enumerate(LABELS):
        lobes = tuple(int(k) for k in np.flatnonzero(groups == group))
        part = model.select(lobes, with_delta=group == 0)
        margin = float(np.abs(np.log2(widths[list(lobes)][:, None] / borders)).min()) if lobes else None
        components.append(Component(label, part, lobes, _half_width(part), margin))
    return Decomposition(*components)


def lobe_widths(model: DSBRDF) -> Array:
    """Reach of each lobe [rad], shape (K,): its median over theta_diff, weighted by its share of the light there.

    Values near grazing are so large that they would decide alone if the light itself was the weight.
    """
    reach, power = lobe_reaches(model)
    total = power.sum(axis=1, keepdims=True)
    share = power / np.where(total > 0.0, total, 1.0)
    return np.array([weighted_median(reach[:, k], share[:, k]) for k in range(model.n_lobes)])


def weighted_median(values: Array, weights: Array) -> float:
    """Smallest value that has at least half of the weight at or below it; shapes (n,)."""
    order = np.argsort(values)
    share = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(share, 0.5 * share[-1])])


def lobe_reaches(model: DSBRDF, theta_diff: Array = _ANGLES) -> tuple[Array, Array]:
    """Reach [rad] and light of each lobe, mean over the channels, at angles theta_diff (n,), shapes (n, K)."""
    parameters = model.parameters_at(theta_diff)
    squared = np.minimum(np.tan(_REACHES), 1e8) ** 2
    kappa, gamma, center = (parameters[name].mean(axis=1)[..., None] for name in ("kappa", "gamma", "center"))
    curves = lobe_values(squared, kappa, gamma, center, model.lobe)
    last = curves.shape[-1] - 1 - np.argmax((curves >= 0.5 * curves.max(axis=-1, keepdims=True))[..., ::-1], axis=-1)
    measure = np.sin(_REACHES) * np.cos(_REACHES) * np.gradient(_REACHES)
    return np.maximum(_REACHES[last], _REACHES[1]), (curves @ measure) * parameters["amplitude"].mean(axis=1)


def _border(widths: Array, threshold: float) -> float:
    """Middle of the widest gap between reaches near the threshold, on a logarithmic scale."""
    low, high = np.log(threshold / _GAP_RANGE), np.log(threshold * _GAP_RANGE)
    inside = np.sort(np.log(widths[(np.log(widths) > low) & (np.log(widths) < high)]))
    ends = np.concatenate([[low], inside, [high]])
    if not inside.size:
        return threshold
    gap = int(np.argmax(np.diff(ends)))
    return float(np.exp(0.5 * (ends[gap] + ends[gap + 1])))


def _half_width(part: DSBRDF) -> float | None:
    if part.n_lobes == 0 and not part.delta.any():
        return None
    values = part.evaluate(_REACHES, 0.0).sum(axis=1)
    return float(_REACHES[np.flatnonzero(values >= 0.5 * values.max())[-1]])
