import io

import numpy as np
import pytest
from PIL import Image

from dsbrdf.data.measurement import Measurement
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.model.image_metrics import displayed
from dsbrdf.model.render import render_sphere, sphere_likeness
from dsbrdf.output.sphere_panels import DIFFERENCE_GAIN, compare_spheres, encode_png, side_by_side
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


def test_panels_of_components_add_up_to_the_fit_and_a_model_equals_itself() -> None:
    found = compare_spheres(MODEL, MODEL, size=24, factor=0.002)
    assert (found.psnr, found.exposure) == (float("inf"), 0.002)
    radiance = [
        np.where(seen > 0.04045, ((seen + 0.055) / 1.055) ** 2.4, seen / 12.92) for seen in found.panels.values()
    ]
    _, whole, difference, *parts = radiance
    assert not difference.any()
    assert len(parts) >= 2
    assert whole.max() < 1.0  # nothing is clipped
    np.testing.assert_allclose(np.sum(parts, axis=0), whole, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("channels", "mode"), [(3, "RGB"), (4, "RGBA")])
def test_pillow_reads_the_pixels_of_a_png(channels: int, mode: str) -> None:
    levels = np.random.default_rng(0).integers(0, 256, (5, 7, channels), dtype=np.uint8)
    values = levels / 255.0
    values[0, :3, 0], levels[0, :3, 0] = (-1.0, 0.5, 7.0), (0, 128, 255)  # values are clipped
    with Image.open(io.BytesIO(encode_png(values))) as image:
        assert image.mode == mode
        assert np.array_equal(np.asarray(image), levels)
