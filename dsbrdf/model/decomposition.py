"""Which lobes are the specular spike, the specular lobe and the diffuse part.

A lobe is labelled by its angular half width at half maximum, not by its index: a spike is as narrow as the
instrument's and the coating's spread, a diffuse part is wide.  A ring lobe reaches from the normal to beyond its
center, so its center counts as width.  One label holds for a lobe over all theta_diff and all channels.  The half
width of a lobe is its median over channels and knots, weighted by the share of the energy that the lobe has there, so
that a lobe is judged where it can be seen.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.hemi_epd import energy, half_width

Array = NDArray[np.float64]

LABELS = ("specular_spike", "specular_lobe", "diffuse")
"""Components, from narrow to wide."""
SPIKE_HALF_WIDTH = float(np.radians(3.0))
"""A lobe with a smaller half width belongs to the specular spike [rad of theta_half]."""
DIFFUSE_HALF_WIDTH = float(np.radians(25.0))
"""A lobe with a larger half width belongs to the diffuse part [rad of theta_half]."""


@dataclass(frozen=True, eq=False)
class Component(DSBRDF):
    """One component: a model made of the lobes that carry its label.

    Attributes
    ----------
    label : str
        One of `LABELS`.
    lobes : tuple of int
        Their indices in the model that was decomposed.
    half_width : float or None
        Half width at half maximum of the lobes, their median weighted by power [rad]; None without lobes.
    albedo : ndarray, shape (3,)
        Directional albedo at normal incidence, RGB.
    margin : float or None
        How clear the label is: the smallest |log2| of the ratio of a lobe's half width to a threshold.  At 1 the
        lobe is twice as wide or as narrow as the nearest threshold, at 0 it lies on it.  None without lobes.
    """

    label: str = LABELS[0]
    lobes: tuple[int, ...] = ()
    half_width: float | None = None
    albedo: Array = None  # type: ignore[assignment]
    margin: float | None = None


@dataclass(frozen=True)
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
    model : DSBRDF
    spike_half_width, diffuse_half_width : float, optional
        Thresholds on the half width of a lobe [rad of theta_half].

    Returns
    -------
    Decomposition
        Components that sum to the model.  The delta term belongs to the spike.

    Raises
    ------
    InvalidArgumentError
        Unless 0 < spike_half_width < diffuse_half_width <= pi/2.
    """
    if not 0.0 < spike_half_width < diffuse_half_width <= np.pi / 2:
        raise InvalidArgumentError(
            "the half width thresholds must satisfy 0 < spike_half_width < diffuse_half_width <= pi/2"
        )
    thresholds = np.array([spike_half_width, diffuse_half_width])
    widths, powers = lobe_widths(model)
    groups = np.searchsorted(thresholds, widths, side="right")
    components = []
    for group, label in enumerate(LABELS):
        lobes = tuple(int(k) for k in np.flatnonzero(groups == group))
        part = model.select(lobes, with_delta=group == 0)
        chosen = widths[list(lobes)]
        components.append(
            Component(
                part.theta_diff,
                part.kappa,
                part.gamma,
                part.center,
                part.delta,
                part.interpolation,
                label=label,
                lobes=lobes,
                half_width=weighted_median(chosen, powers[list(lobes)]) if lobes else None,
                albedo=part.directional_albedo(0.0),
                margin=float(np.abs(np.log2(chosen[:, None] / thresholds)).min()) if lobes else None,
            )
        )
    return Decomposition(*components)


def lobe_widths(model: DSBRDF) -> tuple[Array, Array]:
    """Half width [rad] and weight of each lobe, shapes (K,), over all channels and knots.

    A knot counts by the share that the lobe has, in a channel, of all energy there, and by the range of theta_diff that
    the knot stands for: values near grazing are so large that they would decide alone otherwise.
    """
    extent, power = lobe_extents(model)
    total = power.sum(axis=(0, 2), keepdims=True)
    span = np.gradient(model.theta_diff) if model.theta_diff.size > 1 else np.ones(1)
    weight = power / np.where(total > 0, total, 1.0) * span[:, None]
    lobes = range(model.n_lobes)
    medians = [weighted_median(extent[:, :, k].ravel(), weight[:, :, k].ravel()) for k in lobes]
    return np.array(medians), weight.sum(axis=(0, 1))


def lobe_extents(model: DSBRDF) -> tuple[Array, Array]:
    """Center plus half width [rad], and energy on the hemisphere, of each lobe at each knot, shapes (3, D, K)."""
    extent = model.center + half_width(model.kappa, model.gamma)
    return extent, energy(model.kappa, model.gamma, model.center)


def weighted_median(values: Array, weights: Array) -> float:
    """Smallest value that has at least half of the weight at or below it; shapes (n,)."""
    order = np.argsort(values)
    share = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(share, 0.5 * share[-1])])
