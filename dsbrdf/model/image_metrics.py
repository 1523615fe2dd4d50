"""How alike two rendered images look: exposure, tone curve, PSNR and SSIM.

All images are linear RGB radiance of shape (height, width, 3) until `displayed` turns them into what a screen shows.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_BRIGHT = 0.99
_SIGMA, _RADIUS = 1.5, 5  # The window of Wang et al. (2004): 11 x 11 pixels.
_C1, _C2 = 0.01**2, 0.03**2


def exposure(image: Array, mask: Mask) -> float:
    """Return the factor that takes the 99th percentile of the masked pixels, channels pooled, to 1.

    It is 1 where that percentile is black.

    Parameters
    ----------
    image : ndarray, shape (height, width, 3)
        Linear RGB radiance, as a rule of the measurement: what is compared with it gets the same exposure.
    mask : ndarray of bool, shape (height, width)
        Pixels that count.
    """
    bright = float(np.quantile(image[mask], _BRIGHT))
    return 1.0 / bright if bright > 0.0 else 1.0


def displayed(image: Array, factor: float = 1.0) -> Array:
    """Return what a screen shows of linear radiance: exposed, clipped to [0, 1], with the sRGB curve.

    Parameters
    ----------
    image : ndarray, shape (..., 3)
        Linear RGB radiance.
    factor : float
        Of `exposure`.
    """
    linear = np.clip(image * factor, 0.0, 1.0)
    curve = 1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve)


def psnr(reference: Array, image: Array, mask: Mask) -> float:
    """Peak signal-to-noise ratio of two displayed images, the peak being 1 [dB].

    Parameters
    ----------
    reference, image : ndarray, shape (height, width, 3)
        Values in [0, 1].
    mask : ndarray of bool, shape (height, width)
        Pixels that count; the squared error is averaged over them and the three channels.

    Returns
    -------
    float
        Infinite for equal images.
    """
    error = float(np.mean((reference[mask] - image[mask]) ** 2))
    return float("inf") if error == 0.0 else float(-10.0 * np.log10(error))


def ssim(reference: Array, image: Array, mask: Mask) -> float:
    """Structural similarity of two displayed images (Wang et al. 2004), 1 for equal ones.

    Means, variances and covariance are weighted by a Gaussian window of 11 x 11 pixels, sigma 1.5, in each channel,
    with the constants 0.01**2 and 0.03**2.  Beyond its border an image is black.

    Parameters
    ----------
    reference, image : ndarray, shape (height, width, 3)
        Values in [0, 1].
    mask : ndarray of bool, shape (height, width)
        Centres of the windows that are averaged; the windows themselves see all pixels.

    Returns
    -------
    float
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
