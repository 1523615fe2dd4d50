"""What a user should know of a fit of scattered samples, in one sentence each."""

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.fitting.usual_materials import FAR, UsualMaterial, usual_material

_MUCH_FAR = 0.1  # of the directions
_TOO_BRIGHT = 1.05  # albedo; noise may lift that of a white material above 1
_UNITS = ((np.pi, "1/pi (are they radiance factors?)"), (100.0, "1/100 (are they per cent?)"))
_OTHERWISE = "1/1500 or what else their unit is in 1/sr"
_EXPLAINS = 0.5  # of the cost, that values divided by a cosine have if they were multiplied by it
_BADLY_EXPLAINED = 0.2  # cost for each sample, of values that no known material has; those of materials have up to 1


def coverage_warnings(far: float, *, is_usual: bool) -> tuple[str, ...]:
    """Sentences about the share of directions without a sample nearby, and samples that no free fit can follow."""
    sentences = []
    if is_usual:
        sentences.append(
            "A fit of all parameters follows the samples worse than a material that is like others: the model is that "
            "material, with one specular and one diffuse lobe; more samples would tell more."
        )
    if far > _MUCH_FAR:
        sentences.append(
            f"{far:.0%} of the directions have no sample within {np.degrees(FAR):.0f} degrees: there the model is what "
            "materials are usually like, and not measured."
        )
    return tuple(sentences)


def unit_warnings(samples: ScatteredSamples, usual: UsualMaterial, albedo: NDArray[np.float64]) -> tuple[str, ...]:
    """Sentences about values that are probably not those of a BRDF in 1/sr.

    Parameters
    ----------
    samples : ScatteredSamples
    usual : UsualMaterial
        Of the samples.
    albedo : ndarray
        Directional albedo of the fit at some angles and in all channels.
    """
    largest, sentences = float(albedo.max()), []
    if largest > _TOO_BRIGHT:
        remedy = next((words for factor, words in _UNITS if largest <= factor * _TOO_BRIGHT), _OTHERWISE)
        sentences.append(
            f"The model reflects {largest:.3g} times the light that it receives: the values are not those of a BRDF in "
            f"1/sr; multiply them by {remedy}."
        )
    for side in ("in", "out"):
        cost = usual_material(samples.divided_by_cosine(side)).cost if usual.cost > _BADLY_EXPLAINED else np.inf
        if cost < _EXPLAINS * usual.cost:
            sentences.append(
                f"The values look like a BRDF times the cosine of theta_{side}: divided by it they are those of a "
                f'usual material, and as they are they are not; if so, set cosine to "{side}".'
            )
    return tuple(sentences)
