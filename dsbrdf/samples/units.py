"""Whether the values of samples are those of a BRDF in 1/sr, or what they probably are.

Layers know how bright materials are, and how values go with the cosines of both directions: values that were multiplied
by a factor or by a cosine are less probable as they are than divided by it.
"""

from dataclasses import dataclass, replace

import numpy as np

from dsbrdf.model.albedo import directional_albedo
from dsbrdf.samples.prediction import SampleLayers, thinned
from dsbrdf.samples.scattered_samples import ScatteredSamples

_FACTORS = {
    1.0 / np.pi: "1/pi (scale 0.3183; are they reflectance factors?)",
    1.0 / (100.0 * np.pi): "1/(100 pi) (scale 0.003183; are they reflectance factors in per cent?)",
    1.0 / 100.0: "1/100 (scale 0.01; are they per cent?)",
    1.0 / 1500.0: "1/1500 (scale 0.0006667; are they the integers of a MERL file?)",
}
_MOST = 300  # samples that are asked
_STEEP = np.radians([0.0, 30.0])  # where few samples tell the albedo best
_LARGEST_ALBEDO = 1.05  # noise may lift that of a white material above 1
_LARGEST_ERROR = 0.6  # of values in 1/sr at most 0.4: layers are not bright enough for what is far above
_MORE_PROBABLE = 15.0  # evidence by which values divided by a cosine are better; of values that are right at most 6
_AS_PROBABLE = 20.0  # evidence by which a factor that is named too may be worse
_TYPICAL_ALBEDO = 0.3


@dataclass(frozen=True)
class SampleUnits:
    """What samples probably are."""

    factor: float  # that makes them a BRDF in 1/sr
    sentences: tuple[str, ...]  # for the report; none if they are one as they are


def sample_units(samples: ScatteredSamples) -> SampleUnits:
    """Compare samples as they are with samples times a factor, and divided by a cosine."""
    asked = thinned(samples, _MOST)
    layers = SampleLayers.fit(asked)
    turned = replace(asked, omega_in=asked.omega_in * np.array([-1.0, -1.0, 1.0]))
    if SampleLayers.fit(turned).evidence < layers.evidence - _MORE_PROBABLE:
        said = (
            "The brightest samples lie back towards the light, where mirrors have theirs on the other side: if light "
            'and viewer have the same phi in the mirror direction here, set phi to "mirror", which turns the plane.'
        )
        return SampleUnits(1.0, (said,))
    if not _is_possible(layers):
        return _other_unit(asked)
    found = {side: SampleLayers.fit(asked.divided_by_cosine(side)).evidence for side in ("in", "out")}
    side = min(found, key=lambda name: found[name])
    if found[side] > layers.evidence - _MORE_PROBABLE:
        return SampleUnits(1.0, ())
    said = (
        f"The values look like a BRDF times the cosine of theta_{side}: divided by it they are those of a usual "
        f'material, and as they are they are not; if so, set cosine to "{side}".'
    )
    return SampleUnits(1.0, (said,))


def _other_unit(samples: ScatteredSamples) -> SampleUnits:
    """Name the factors that make samples a possible material, the usual ones first, and a cosine if it is likely."""
    begin = "The samples reflect more light than they receive: they are not a BRDF in 1/sr; multiply the values by "
    evidence: dict[tuple[float, str | None], float] = {}
    for side in (None, "in", "out"):
        divided = samples if side is None else samples.divided_by_cosine(side)
        for factor in _FACTORS:
            layers = SampleLayers.fit(replace(divided, values=divided.values * factor))
            if _is_possible(layers):
                evidence[factor, side] = layers.evidence + (0.0 if side is None else _MORE_PROBABLE)
    if not evidence:
        bright = np.pi * float(np.median(samples.values)) + 1e-4 * float(samples.values.max())
        return SampleUnits(_TYPICAL_ALBEDO / bright, (begin + "what makes them 1/sr.",))
    best, side = min(evidence, key=lambda key: evidence[key])
    limit = evidence[best, side] + _AS_PROBABLE
    likely = [factor for factor in _FACTORS if evidence.get((factor, side), np.inf) < limit]
    words = begin + " or ".join(_FACTORS[factor] for factor in likely)
    if side is not None:
        words += f', and set cosine to "{side}": they look like a BRDF times the cosine of theta_{side}'
    return SampleUnits(likely[0], (words + ".",))


def _is_possible(layers: SampleLayers) -> bool:
    albedo = directional_albedo(layers.evaluate_unmasked, _STEEP).min(axis=0).max()
    return bool(albedo <= _LARGEST_ALBEDO) and layers.found[0].error < _LARGEST_ERROR
