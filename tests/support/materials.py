"""The synthetic materials that most tests are about, each made once."""

from functools import cache

from dsbrdf import Measurement
from dsbrdf.data import synthetic_measurement


@cache
def glossy_plastic() -> Measurement:
    """A glossy coloured plastic with 2 % noise."""
    return synthetic_measurement(noise=0.02, seed=1, name="plastic")


@cache
def polished_metal() -> Measurement:
    """A polished coloured metal without a diffuse part and without noise."""
    return synthetic_measurement(roughness=0.05, diffuse=(0.0, 0.0, 0.0), specular=(0.95, 0.64, 0.54), name="metal")


@cache
def matte_paint() -> Measurement:
    """A rough, nearly diffuse material without noise."""
    return synthetic_measurement(roughness=0.7, diffuse=(0.6, 0.5, 0.4), specular=(0.02, 0.02, 0.02), name="matte")
