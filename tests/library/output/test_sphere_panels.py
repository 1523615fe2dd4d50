"""Panels of lit spheres against the pictures that they consist of."""

import numpy as np

from dsbrdf.data.measurement import Measurement
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.model.image_metrics import displayed
from dsbrdf.model.render import render_sphere, sphere_likeness
from dsbrdf.output.sphere_panels import DIFFERENCE_GAIN, compare_spheres, side_by_side
from tests.support.mixtures import mixture

MODEL = mixture(3, 0)


def test_panels_have_the_exposure_of_the_measurement(plastic: Measurement) -> None:
    found = compare_spheres(plastic, MODEL, size=24)
    measured, fitted = (render_sphere(source, size=24) for source in (plastic, MODEL))
    seen, compared = displayed(measured, found.exposure), displayed(fitted, found.exposure)
    np.testing.assert_array_equal(found.panels["measured"], seen)
    np.testing.assert_array_equal(found.panels["fit"], compared)
    difference = np.minimum(DIFFERENCE_GAIN * np.abs(seen - compared), 1.0)
    np.testing.assert_allclose(found.panels["difference x 4"], difference)
    assert (found.psnr, found.ssim) == sphere_likeness(measured, fitted)
    assert list(found.panels)[3:] == [component.label.replace("_", " ") for component in decompose(MODEL)]
    picture = side_by_side(found.panels)
    assert picture.shape == (24, len(found.panels) * 24, 3)
    np.testing.assert_array_equal(picture[:, 24:48], compared)


def test_panels_of_components_add_up_to_the_fit() -> None:
    panels = compare_spheres(MODEL, MODEL, size=24, factor=0.002).panels
    radiance = [np.where(seen > 0.04045, ((seen + 0.055) / 1.055) ** 2.4, seen / 12.92) for seen in panels.values()]
    _, whole, _, *parts = radiance
    assert len(parts) >= 2
    assert whole.max() < 1.0  # nothing is clipped
    np.testing.assert_allclose(np.sum(parts, axis=0), whole, rtol=1e-9, atol=1e-12)


def test_a_model_equals_itself() -> None:
    found = compare_spheres(MODEL, MODEL, size=16, lighting="environment", factor=0.3)
    assert found.psnr == float("inf")
    assert not found.panels["difference x 4"].any()
    assert found.exposure == 0.3
