"""Spectra of RGB values, for renderers that compute with wavelengths: a red, a green and a blue one, added.

They are 1 in sum at every wavelength and never negative, so that grey stays grey and no energy is added; lit by D65 and
seen by the CIE 1931 observer each is its own primary of linear sRGB again, to 1e-4.  Among the spectra that do so these
are the smoothest: the sum of their squared steps is the smallest (after Mallett and Yuksel 2019, "Spectral primary
decomposition for rendering with sRGB reflectance").  A BRDF's values may be above 1: what is added is linear in them.
"""

import numpy as np
from numpy.typing import NDArray

__all__ = ["SPECTRA", "WAVELENGTHS", "spectra_of_rgb"]

Array = NDArray[np.float64]

WAVELENGTHS = np.arange(400.0, 701.0, 20.0)
"""Nodes between which spectra are linear, and beyond which they are held [nm]."""
_RED = [0.0574, 0.0537, 0.0299, 0.0047, 0, 0, 0, 0, 0, 0.1347, 0.7972, 1, 1, 1, 1, 1]
_GREEN = [0, 0, 0, 0, 0.2587, 0.7471, 1, 1, 1, 0.7935, 0.2002, 0, 0, 0, 0, 0]
SPECTRA = np.array([_RED, _GREEN, 1.0 - np.add(_RED, _GREEN)])
"""Spectra of red, green and blue at the nodes, shape (3, 16)."""


def spectra_of_rgb(rgb: NDArray[np.floating]) -> Array:
    """Spectra (..., 16) at `WAVELENGTHS` of values (..., 3) in linear sRGB."""
    return np.asarray(rgb @ SPECTRA)
