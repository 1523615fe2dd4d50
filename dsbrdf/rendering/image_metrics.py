"""Compare two rendered images by exposure, tone curve, PSNR and SSIM.

Images (height, width, 3) have linear RGB radiance, which `displayed` converts to values of a screen.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from dsbrdf.arrays import Array, Mask

_EXPOSURE_QUANTILE = 0.99  # An exposure scales this quantile of the pixels to 1.
# The window of SSIM has 11 x 11 pixels (Wang, Bovik, Sheikh and Simoncelli 2004).
_WINDOW_SIGMA_PX = 1.5
_WINDOW_RADIUS_PX = 5
_C1, _C2 = 0.01**2, 0.03**2


def exposure(image: Array, mask: Mask) -> float:
    """Return the factor that scales the 99th percentile of the masked values of all channels to 1, or 1 if all are 0.

    The image usually shows a measurement; images that are compared with this image are scaled by the factor as well.
    """
    bright = float(np.quantile(image[mask], _EXPOSURE_QUANTILE))
    return 1.0 / bright if bright > 0.0 else 1.0


def displayed(image: Array, factor: float = 1.0) -> Array:
    """Convert radiance (..., 3) to values of a screen: multiply by `factor`, clip to [0, 1], apply the sRGB curve."""
    linear = np.clip(image * factor, 0.0, 1.0)
    curve = 1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve)


def psnr(reference: Array, image: Array, mask: Mask) -> float:
    """Return the peak signal-to-noise ratio [dB] of two displayed images with peak 1; infinite for equal images.

    The squared error is averaged over the pixels of the mask and the three channels.
    """
    error = float(np.mean((reference[mask] - image[mask]) ** 2))
    return float("inf") if error == 0.0 else float(-10.0 * np.log10(error))


def ssim(reference: Array, image: Array, mask: Mask) -> float:
    """Return the structural similarity (Wang and others 2004) of two displayed images; 1 for equal images.

    Means, variances and covariance are weighted by a Gaussian window of 11 x 11 pixels, sigma 1.5, in each channel,
    with the constants 0.01**2 and 0.03**2. The result is the mean over all windows whose centre is in the mask. An
    image is continued in black beyond its border.
    """
    mean_a, mean_b = _windowed(reference), _windowed(image)
    variances = _windowed(reference**2) + _windowed(image**2) - mean_a**2 - mean_b**2
    covariance = _windowed(reference * image) - mean_a * mean_b
    likeness = (2.0 * mean_a * mean_b + _C1) * (2.0 * covariance + _C2)
    likeness /= (mean_a**2 + mean_b**2 + _C1) * (variances + _C2)
    return float(np.mean(likeness[mask]))


def _windowed(image: Array) -> Array:
    """Return the mean over the Gaussian window about each pixel."""
    return np.asarray(
        gaussian_filter(
            image,
            (_WINDOW_SIGMA_PX, _WINDOW_SIGMA_PX, 0.0),
            mode="constant",
            radius=(_WINDOW_RADIUS_PX, _WINDOW_RADIUS_PX, 0),
        )
    )
