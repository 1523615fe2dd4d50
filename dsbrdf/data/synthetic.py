"""Make measurements of analytic materials and of models, on the full MERL grid.

The analytic material is the sum of a GGX microfacet lobe (Walter et al. 2007) with height-correlated Smith shadowing
and Schlick's Fresnel term, and of the diffuse term of Ashikhmin and Shirley (2000), which decreases where the
surface reflection increases. The sum is reciprocal and conserves energy.
"""

from typing import Protocol

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import PHI_DIFF, THETA_DIFF, THETA_HALF, incident_cosines, nodes_above_horizon
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError

_Triple = tuple[float, float, float]


class Reflectance(Protocol):
    """Declare a model with RGB values at half and difference angles, such as `dsbrdf.DSBRDF`."""

    def evaluate(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values in 1/sr, shape (..., 3), at angles in radians."""
        ...


def synthetic_measurement(
    *,
    roughness: float = 0.1,
    diffuse: _Triple = (0.30, 0.12, 0.06),
    specular: _Triple = (0.05, 0.05, 0.05),
    noise: float = 0.0,
    seed: int = 0,
    name: str = "synthetic",
) -> Measurement:
    """Return the measurement of an analytic material; all nodes above the horizon are valid.

    Parameters
    ----------
    roughness : float
        Roughness ``alpha`` of the GGX distribution, in [0.005, 1].
    diffuse, specular : tuple of float
        RGB albedo of the diffuse term, and RGB reflectance of the surface at normal incidence (``F0``), in [0, 1].
    noise : float
        Standard deviation of the log-normal factor with mean 1 that multiplies every value, in [0, 1].
    seed : int
        Seed of the noise; equal arguments give equal bytes.
    name : str
        The material's name.

    Raises
    ------
    InvalidArgumentError
        If a parameter is out of its range.
    """
    if not 0.005 <= roughness <= 1.0:
        raise InvalidArgumentError(f"roughness must be in [0.005, 1], not {roughness:g}.")
    for kind, colour in (("diffuse", diffuse), ("specular", specular)):
        if np.shape(colour) != (3,) or not all(0.0 <= value <= 1.0 for value in colour):
            raise InvalidArgumentError(f"{kind} must be three numbers (RGB) in [0, 1], not {colour}.")
    above = nodes_above_horizon()
    cos_in, cos_out = (
        cosine[above] for cosine in incident_cosines(THETA_HALF[:, None, None], THETA_DIFF[:, None], PHI_DIFF)
    )
    cos_half, cos_diff = (
        np.broadcast_to(cosine, above.shape)[above]
        for cosine in (np.cos(THETA_HALF)[:, None, None], np.cos(THETA_DIFF)[:, None])
    )
    lobe = _ggx(cos_half, cos_in, cos_out, roughness)
    grazing = (1.0 - cos_diff) ** 5
    diffuse_term = 28.0 / (23.0 * np.pi) * (1.0 - (1.0 - cos_in / 2) ** 5) * (1.0 - (1.0 - cos_out / 2) ** 5)
    values = np.full((3, *above.shape), -1.0)
    for channel, (albedo, reflectance) in enumerate(zip(diffuse, specular, strict=True)):
        fresnel = reflectance + (1.0 - reflectance) * grazing
        values[channel, above] = fresnel * lobe + albedo * (1.0 - reflectance) * diffuse_term
    return Measurement.from_values(_noisy(values, noise, seed), above, name)


def model_measurement(model: Reflectance, *, noise: float = 0.0, seed: int = 0, name: str = "model") -> Measurement:
    """Return a measurement with the values of a model at all nodes above the horizon.

    The arguments `noise`, `seed` and `name` are as in `synthetic_measurement`. Raises MeasurementFormatError if the
    values of the model are not a valid measurement, for example if one is NaN.
    """
    above = nodes_above_horizon()
    values = np.full((3, *above.shape), -1.0)
    for row, theta_half in enumerate(THETA_HALF):
        diff, phi = np.nonzero(above[row])
        values[:, row, diff, phi] = model.evaluate(theta_half, THETA_DIFF[diff], PHI_DIFF[phi]).T
    return Measurement.from_values(_noisy(values, noise, seed), above, name)


def _ggx(cos_half: Array, cos_in: Array, cos_out: Array, alpha: float) -> Array:
    """Return the GGX distribution times the shadowing of both directions, divided by 4 cos_in cos_out."""
    square = alpha * alpha
    # The sum is 1 + (square - 1) cos_half**2, written in a form without cancellation at cos_half = 1.
    slope = (1.0 - cos_half) * (1.0 + cos_half) + square * cos_half**2
    distribution = square / (np.pi * slope**2)
    smith_in = cos_out * np.sqrt(square + (1.0 - square) * cos_in**2)
    smith_out = cos_in * np.sqrt(square + (1.0 - square) * cos_out**2)
    return np.asarray(distribution * 0.5 / (smith_in + smith_out), dtype=np.float64)


def _noisy(values: Array, noise: float, seed: int) -> Array:
    if not 0.0 <= noise <= 1.0:
        raise InvalidArgumentError(f"noise must be in [0, 1], not {noise:g}.")
    if noise == 0.0:
        return values
    variance = np.log1p(noise * noise)
    factor = np.random.default_rng(seed).standard_normal(values.shape)
    factor *= np.sqrt(variance)
    factor -= variance / 2
    # All operations are in place, because allocating new arrays of 35 MB takes longer than the arithmetic.
    np.exp(factor, out=factor)
    factor *= values
    return factor
