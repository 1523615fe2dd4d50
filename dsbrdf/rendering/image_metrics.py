"""How alike two rendered images look: exposure, tone curve, PSNR and SSIM.

All images are linear RGB radiance of shape (height, width, 3) until `displayed` turns them into what a screen shows.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from dsbrdf.arrays import Array, Mask

_BRIGHT = 0.99
_SIGMA, _RADIUS = 1.5, 5  # The window of Wang et al. (2004): 11 x 11 pixels.
_C1, _C2 = 0.01**2, 0.03**2


def exposure(image: Array, mask: Mask) -> float:
    """Return the factor that takes the 99th percentile of the masked pixels, channels pooled, to 1; 1 if it is black.

    As a rule the image is that of the measurement: what is compared with it gets the same exposure.
    """
    bright = float(np.quantile(image[mask], _BRIGHT))
    return 1.0 / bright if bright > 0.0 else 1.0


def displayed(image: Array, factor: float = 1.0) -> Array:
    """Return what a screen shows of radiance (..., 3): times `factor`, clipped to [0, 1], with the sRGB curve."""
    linear = np.clip(image * factor, 0.0, 1.0)
    curve = 1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve)


def psnr(reference: Array, image: Array, mask: Mask) -> float:
    """Peak signal-to-noise ratio of two displayed images, the peak being 1 [dB]; infinite for equal ones.

    The squared error is averaged over the pixels of the mask and the three channels.
    """
    error = float(np.mean((reference[mask] - image[mask]) ** 2))
    return float("inf") if error == 0.0 else float(-10.0 * np.log10(error))


def ssim(reference: Array, image: Array, mask: Mask) -> float:
    """Structural similarity of two displayed images (Wang et al. 2004), 1 for equal ones.

    Means, variances and covariance are weighted by a Gaussian window of 11 x 11 pixels, sigma 1.5, in each channel,
    with the constants 0.01**2 and 0.03**2. Windows are averaged whose centres are in the mask; they see all pixels,
    and beyond its border an image is black.
    """
    mean_a, mean_b = _windowed(reference), _windowed(image)
    variances = _windowed(reference**2) + _windowed(image**2) - mean_a**2 - mean_b**2
    covariance = _windowed(reference * image) - mean_a * mean_b
    likeness = (2.0 * mean_a * mean_b + _C1) * (2.0 * covariance + _C2)
    likeness /= (mean_a**2 + mean_b**2 + _C1) * (variances + _C2)
    return float(np.mean(likeness[mask]))


def _windowed(image: Array) -> Array:
    """Mean over the window about each pixel."""
    return np.asarray(gaussian_filter(image, (_SIGMA, _SIGMA, 0.0), mode="constant", radius=(_RADIUS, _RADIUS, 0)))
