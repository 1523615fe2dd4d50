"""Exposure, tone curve, PSNR and SSIM against plain loops and published values."""

import numpy as np
import pytest

from dsbrdf.model.image_metrics import displayed, exposure, psnr, ssim


def images(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    reference = generator.uniform(size=(14, 17, 3))
    image = np.clip(reference + 0.1 * generator.standard_normal(reference.shape), 0.0, 1.0)
    return reference, image, generator.uniform(size=reference.shape[:2]) > 0.3


def test_psnr_is_that_of_a_plain_loop() -> None:
    reference, image, mask = images()
    total, count = 0.0, 0
    for y, x in zip(*np.nonzero(mask), strict=True):
        for channel in range(3):
            total += (reference[y, x, channel] - image[y, x, channel]) ** 2
            count += 1
    assert psnr(reference, image, mask) == pytest.approx(10.0 * np.log10(1.0 / (total / count)), rel=1e-12)


def test_ssim_is_that_of_a_plain_loop() -> None:
    reference, image, mask = images()
    offsets = np.arange(-5, 6)
    window = np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2.0 * 1.5**2))
    window /= window.sum()
    padded = [np.pad(picture, ((5, 5), (5, 5), (0, 0))) for picture in (reference, image)]
    likeness = []
    for y, x in zip(*np.nonzero(mask), strict=True):
        for channel in range(3):
            a, b = (picture[y : y + 11, x : x + 11, channel] for picture in padded)
            mean_a, mean_b = (window * a).sum(), (window * b).sum()
            var_a, var_b = (window * (a - mean_a) ** 2).sum(), (window * (b - mean_b) ** 2).sum()
            covariance = (window * (a - mean_a) * (b - mean_b)).sum()
            likeness.append(
                (2 * mean_a * mean_b + 1e-4)
                * (2 * covariance + 9e-4)
                / ((mean_a**2 + mean_b**2 + 1e-4) * (var_a + var_b + 9e-4))
            )
    assert ssim(reference, image, mask) == pytest.approx(np.mean(likeness), rel=1e-10)


def test_equal_images_are_alike() -> None:
    reference, _, mask = images()
    assert psnr(reference, reference, mask) == float("inf")
    assert ssim(reference, reference, mask) == pytest.approx(1.0, abs=1e-12)


def test_pixels_outside_the_mask_do_not_count_for_psnr() -> None:
    reference, image, mask = images()
    before = psnr(reference, image, mask)
    image[~mask] = 1.0 - reference[~mask]
    assert psnr(reference, image, mask) == before


def test_display_is_the_srgb_curve() -> None:
    # IEC 61966-2-1: code values 0, 1, 10, 11, 128, 188, 255 of 255 and their linear values.
    codes = np.array([0.0, 1.0, 10.0, 11.0, 128.0, 188.0, 255.0])
    linear = np.array([0.0, 0.000303527, 0.00303527, 0.00334654, 0.215861, 0.502886, 1.0])
    np.testing.assert_allclose(255.0 * displayed(linear), codes, atol=1e-3)
    np.testing.assert_allclose(displayed(np.array([-1.0, 2.0])), [0.0, 1.0], rtol=1e-12)
    np.testing.assert_allclose(displayed(np.array([0.25]), 2.0), displayed(np.array([0.5])))


def test_exposure_takes_the_99th_percentile_to_one() -> None:
    image, _, mask = images()
    image = 7.0 * image
    exposed = exposure(image, mask) * image[mask]
    assert np.mean(exposed > 1.0) == pytest.approx(0.01, abs=2.0 / exposed.size)
    assert exposure(np.zeros_like(image), mask) == 1.0
