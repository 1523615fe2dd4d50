"""Check samples for wrong units, a cosine in the values, a turned plane, and highlights of a single sample.

Nothing here changes a value. A wrong factor is detected by energy alone: if a lower bound of the albedo is above 1, the
samples reflect more light than they receive. The bound takes the minimum of neighbouring samples over theta_half, so
that a highlight of a single sample does not count. If values were multiplied by a cosine, layers fit them less well
than the values divided by this cosine.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import half_difference, spherical
from dsbrdf.samples.prediction import thinned
from dsbrdf.samples.sample_layers import SampleLayers
from dsbrdf.samples.scattered_samples import ScatteredSamples

_MAX_ALBEDO_BOUND = 1.05  # noise may lift the bound of a white material above 1
# Each factor has a prior probability and a phrase for a sentence.
_FACTORS = {
    1.0 / np.pi: (0.4, "1/pi (scale 0.3183; are they reflectance factors?)"),
    1.0 / (100.0 * np.pi): (0.35, "1/(100 pi) (scale 0.003183; are they reflectance factors in per cent?)"),
    1.0 / 100.0: (0.2, "1/100 (scale 0.01; are they per cent?)"),
}
_MERL_FACTOR = 1.0 / 1500.0
_OF_INTEGERS = (1.0, "1/1500 (scale 0.0006667; are they the integers of a MERL file?)")
# Prior mean of the albedo, and standard deviation of its logarithm.
_USUAL_ALBEDO = 0.3
_ALBEDO_SPREAD = 1.1
# Darker samples are scaled to the usual albedo before they are fitted.
_MIN_LEVEL = 1e-5
_NAMED_FRACTION = 0.1
_INCIDENCE_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
_NEAR_INCIDENCE = np.radians(7.6)
_MIN_IN_GROUP = 6  # An angle of incidence with fewer samples is ignored.
# The bound of the albedo takes the minimum of this number of neighbours over theta_half.
_N_NEIGHBOURS = 4
# Layers are fitted to at most this number of samples.
_MAX_ASKED_SAMPLES = 300
# A cosine or a turned plane is reported if it improves the evidence by more; for correct values, it improves up to 6.
_MORE_PROBABLE = 15.0
# A cosine in the values is only reported if layers fit the corrected values with a smaller relative error.
_MAX_LAYER_ERROR = 0.3
# A single sample is a spike if it is near the mirror direction and brighter than its neighbours by this factor.
_SPIKE_FACTOR = 8.0
_SPIKE_THETA_HALF = np.radians(3.0)


@dataclass(frozen=True)
class SampleDoubts:
    """Hold properties of samples that a user should check.

    Attributes
    ----------
    factor : float
        Factor that gives the samples a usual albedo; 1 if their albedo is usual already.
    sentences : tuple of str
        A sentence on each property to check.
    """

    factor: float
    sentences: tuple[str, ...]


def sample_doubts(samples: ScatteredSamples) -> SampleDoubts:
    """Return the properties of samples that should be checked."""
    bound = albedo_bound(samples)
    # For few samples, the bound is far below the albedo, and the median is a better estimate.
    level = max(bound, np.pi * float(np.median(samples.values)) + 1e-4 * float(samples.values.max()))
    factors = _likely_factors(samples.values, level) if bound > _MAX_ALBEDO_BOUND else []
    sentences = _about_energy(samples, bound, factors) if factors else _about_layers(samples)
    factor = factors[0][0] if factors else 1.0 if level > _MIN_LEVEL else _USUAL_ALBEDO / level
    return SampleDoubts(factor, (*sentences, *_about_spikes(samples)))


def _about_energy(samples: ScatteredSamples, bound: float, factors: list[tuple[float, str]]) -> Iterator[str]:
    asked = thinned(samples, _MAX_ASKED_SAMPLES)
    side = _side_of_cosine(replace(asked, values=asked.values * factors[0][0]))
    named = " or ".join(words for _, words in factors)
    cosine = "" if side is None else f', and set cosine to "{side}": they look like a BRDF times that cosine'
    yield (
        f"The samples reflect more light than they receive, at least {bound:.3g} times as much: they are not a "
        f"BRDF in 1/sr; multiply the values by {named}{cosine}."
    )


def _about_layers(samples: ScatteredSamples) -> Iterator[str]:
    asked = thinned(samples, _MAX_ASKED_SAMPLES)
    layers = SampleLayers.fit(asked)
    turned = replace(asked, omega_in=asked.omega_in * np.array([-1.0, -1.0, 1.0]))
    if SampleLayers.fit(turned).evidence < layers.evidence - _MORE_PROBABLE:
        yield (
            "The brightest samples lie back towards the light, as those of a retro-reflector do: if the material is "
            "none, light and viewer have the same phi in the mirror direction here, and phi must be set to "
            '"mirror", which turns the plane.'
        )
        return
    side = _side_of_cosine(asked, layers)
    if side is not None:
        yield (
            f"The values look like a BRDF times the cosine of theta_{side}: divided by it they are those of a usual "
            f'material, and as they are they are not; if so, set cosine to "{side}".'
        )


def _side_of_cosine(samples: ScatteredSamples, layers: SampleLayers | None = None) -> str | None:
    """Return "in" or "out" if the values were probably multiplied by this direction's cosine, else None."""
    evidence = (layers or SampleLayers.fit(samples)).evidence
    found = {side: SampleLayers.fit(samples.divided_by_cosine(side)) for side in ("in", "out")}
    side = min(found, key=lambda name: found[name].evidence)
    is_clear = found[side].evidence < evidence - _MORE_PROBABLE and found[side].found[0].error < _MAX_LAYER_ERROR
    return side if is_clear else None


def _likely_factors(values: Array, level: float) -> list[tuple[float, str]]:
    """Return the factors that turn an albedo of about `level` into a usual albedo, the most probable first."""
    is_integer = bool(np.all(values == np.rint(values)))
    known = _FACTORS | ({_MERL_FACTOR: _OF_INTEGERS} if is_integer else {})
    scores = {
        factor: np.log(prior) - 0.5 * (np.log(level * factor / _USUAL_ALBEDO) / _ALBEDO_SPREAD) ** 2
        for factor, (prior, _) in known.items()
    }
    best = max(scores.values())
    order = sorted(scores, key=lambda factor: -scores[factor])
    if order[0] * level > _MAX_ALBEDO_BOUND:
        return [(_USUAL_ALBEDO / level, "what makes them 1/sr")]
    return [(factor, known[factor][1]) for factor in order if scores[factor] > best + np.log(_NAMED_FRACTION)]


def albedo_bound(samples: ScatteredSamples) -> float:
    """Return a lower bound of the directional albedo of samples, the largest over angles of incidence and channels.

    At each angle of incidence, values are a function of theta_half: the minimum of the samples next to each direction,
    and 0 beyond the last sample.
    """
    theta_half = half_difference(samples.omega_in, samples.omega_out)[0]
    cosines = np.stack([samples.omega_in[:, 2], samples.omega_out[:, 2]])
    angles, largest = np.arccos(np.clip(cosines, 0.0, 1.0)), 0.0
    for incidence in _INCIDENCE_DEG:
        near = np.any(np.abs(angles - np.radians(incidence)) < _NEAR_INCIDENCE, axis=0)
        if np.count_nonzero(near) < _MIN_IN_GROUP:
            continue
        order = np.argsort(theta_half[near])
        half, values = theta_half[near][order], samples.values[near][order]
        nodes, weight = _outgoing(incidence)
        # Each node has one neighbour below and the next ones above.
        at = np.searchsorted(half, nodes)[:, np.newaxis] + np.arange(-1, _N_NEIGHBOURS - 1)
        least = values[np.clip(at, 0, half.size - 1)].min(axis=1)
        least[nodes > half[-1]] = 0.0
        largest = max(largest, float((weight @ least).max()))
    return largest


@cache
def _outgoing(incidence_deg: float) -> tuple[Array, Array]:
    """Return theta_half of directions omega_out, shape (n,), and their cosine-weighted solid angles."""
    theta, phi = np.meshgrid(np.radians(np.arange(0.5, 90.0)), np.radians(np.arange(1.5, 180.0, 3.0)), indexing="ij")
    omega_out = spherical(theta.ravel(), phi.ravel())
    omega_in = np.broadcast_to(spherical(np.radians(incidence_deg), np.pi), omega_out.shape)
    weight = np.sin(theta) * np.cos(theta)
    return half_difference(omega_in, omega_out)[0], np.pi * (weight / weight.sum()).ravel()


def _about_spikes(samples: ScatteredSamples) -> Iterator[str]:
    """Yield a sentence if highlights contain only a single sample at most angles of incidence."""
    theta_half = half_difference(samples.omega_in, samples.omega_out)[0]
    incidence = np.degrees(np.arccos(np.clip(samples.omega_in[:, 2], 0.0, 1.0))).round(1)
    level = samples.values.mean(axis=1)
    seen, covered, ratios, gaps = 0, 0, list[float](), list[float]()
    for angle in np.unique(incidence):
        group = np.flatnonzero(incidence == angle)
        if group.size < _MIN_IN_GROUP:
            continue
        covered += group.size
        order = group[np.argsort(theta_half[group])]
        # Several samples at one pair of directions count as one.
        first = np.flatnonzero(theta_half[order] > theta_half[order[0]] + 1e-3)
        if theta_half[order[0]] > _SPIKE_THETA_HALF or first.size < _MIN_IN_GROUP - 1:
            continue
        seen += 1
        beside = level[order[first[:_N_NEIGHBOURS]]].max()
        if level[order[0]] > _SPIKE_FACTOR * beside > 0.0:
            ratios.append(float(level[order[0]] / beside))
            gaps.append(float(np.degrees(theta_half[order[first[0]]])))
    # Random directions seldom have equal angles of incidence, so most samples must be in such groups.
    if ratios and 2 * len(ratios) >= seen and 2 * covered > len(level):
        yield (
            f"At {len(ratios)} angles of incidence one sample alone lies in the highlight: it is up to "
            f"{max(ratios):.2g} times as bright as its neighbours, at theta_half = {np.median(gaps):.2g} degrees and "
            "more: the samples tell the height of the highlight there, and not its width; measure between them."
        )
