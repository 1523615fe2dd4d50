"""Lit spheres against closed forms and plain sums over the directions of the light."""

from collections.abc import Callable

import numpy as np
import pytest

from dsbrdf.data.geometry import half_difference, incident_cosines
from dsbrdf.data.interpolation import interpolate
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.environment import SUN, THREE_LIGHTS, Light, environment_radiance
from dsbrdf.model.image_metrics import displayed, exposure, psnr
from dsbrdf.model.render import LIGHTINGS, render_sphere, sphere_likeness, sphere_normals

ALBEDO = np.array([0.8, 0.5, 0.2])
Evaluate = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def lambertian(theta_half: np.ndarray, _theta_diff: np.ndarray, _phi_diff: np.ndarray) -> np.ndarray:
    return ALBEDO / np.pi * np.ones((*theta_half.shape, 1))


def glossy(theta_half: np.ndarray, theta_diff: np.ndarray, phi_diff: np.ndarray) -> np.ndarray:
    """A lobe 10 degrees wide that depends on all angles, and on the sense of phi_diff."""
    shape = np.exp(-((theta_half / np.radians(10.0)) ** 2)) * (1.0 + theta_diff)
    return (shape * (2.0 + np.cos(2.0 * phi_diff) + np.sin(2.0 * phi_diff)))[..., np.newaxis] * ALBEDO


def mirror(theta_half: np.ndarray, theta_diff: np.ndarray, phi_diff: np.ndarray) -> np.ndarray:
    """A lobe of half a degree that returns all light, whatever the direction."""
    width = np.radians(0.5)
    lobe = np.exp(-((theta_half / width) ** 2)) / (np.pi * width**2)
    cos_in, _ = incident_cosines(theta_half, theta_diff, phi_diff)
    return (lobe / (4.0 * np.cos(theta_diff) * np.maximum(cos_in, 1e-3)))[..., np.newaxis] * np.ones(3)


def some_pixels(size: int, count: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows and columns of pixels all over the sphere, and their normals (count, 3)."""
    normals, mask = sphere_normals(size)
    chosen = np.linspace(0, len(normals) - 1, count).astype(int)
    row, column = (index[chosen] for index in np.nonzero(mask))
    return row, column, normals[chosen]


def gathered_radiance(normal: np.ndarray, evaluate: Evaluate) -> np.ndarray:
    """Reflected radiance towards the view by a plain sum over 200,000 directions of the light."""
    count = 200_000
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    direction = np.stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z], axis=-1)
    # A frame by Gram and Schmidt: its azimuth does not matter, its handedness does.
    x = np.cross(normal, (0.6, -0.8, 0.0))
    x /= np.linalg.norm(x)
    frame = np.array([x, np.cross(normal, x), normal])

    def reflected(towards: np.ndarray, light: np.ndarray) -> np.ndarray:
        local = towards @ frame.T
        above = local[:, 2] > 0.0
        values = evaluate(*half_difference(local[above], frame @ (0.0, 0.0, 1.0)))
        return np.sum(values * light[above] * local[above, 2:], axis=0)

    sun = reflected(np.array([SUN.direction]), np.array([SUN.irradiance]))
    return sun + 4.0 * np.pi / count * reflected(direction, environment_radiance(direction))


def test_normals_are_those_of_a_sphere_seen_from_the_front() -> None:
    normals, mask = sphere_normals(40)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-12)
    assert mask.sum() == pytest.approx(np.pi / 4 * 40**2, rel=0.01)
    assert normals[0, 1] > 0.9  # up
    row, column = np.nonzero(mask)
    np.testing.assert_allclose(normals[:, 0], (column + 0.5) / 20 - 1.0, atol=1e-12)
    np.testing.assert_allclose(normals[:, 1], 1.0 - (row + 0.5) / 20, atol=1e-12)
    assert (normals[:, 2] > 0.0).all()


def test_a_lambertian_sphere_under_three_lights_has_a_closed_form() -> None:
    normals, mask = sphere_normals(50)
    expected = np.zeros((50, 50, 3))
    for light in THREE_LIGHTS:
        cosine = np.maximum(normals @ np.array(light.direction), 0.0)
        expected[mask] += cosine[:, np.newaxis] * np.array(light.irradiance) * ALBEDO / np.pi
    np.testing.assert_allclose(render_sphere(lambertian, size=50), expected, rtol=1e-12)


def test_a_highlight_is_where_the_half_vector_is_the_normal() -> None:
    image = render_sphere(lambda half, _diff, _phi: np.exp(-((half / 0.05) ** 2))[..., None] * ALBEDO, size=200)
    for light in THREE_LIGHTS:
        np.testing.assert_allclose(np.linalg.norm(light.direction), 1.0, rtol=1e-12)
        half = np.add(light.direction, (0.0, 0.0, 1.0))
        half /= np.linalg.norm(half)
        row, column = int(100 * (1.0 - half[1])), int(100 * (1.0 + half[0]))
        near = np.pad(image[..., 0], 15)[row : row + 31, column : column + 31]
        assert np.abs(np.array(np.unravel_index(near.argmax(), near.shape)) - 15).max() <= 2


@pytest.mark.parametrize(("evaluate", "tolerance"), [(lambertian, 0.006), (glossy, 0.015)])
def test_the_environment_is_summed_up(evaluate: Evaluate, tolerance: float) -> None:
    image = render_sphere(evaluate, lighting="environment", size=64)
    row, column, normals = some_pixels(64)
    expected = np.array([gathered_radiance(normal, evaluate) for normal in normals])
    np.testing.assert_allclose(image[row, column], expected, rtol=tolerance, atol=0.1 * tolerance * expected.max())


def test_a_mirror_shows_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dsbrdf.model.render.SUN", Light(SUN.direction, (0.0, 0.0, 0.0)))
    image = render_sphere(mirror, lighting="environment", size=128)
    normals, mask = sphere_normals(128)
    reflected = 2.0 * normals[:, 2:] * normals - (0.0, 0.0, 1.0)
    expected = np.zeros_like(image)
    expected[mask] = environment_radiance(reflected)
    inner = mask.copy()
    inner[mask] = normals[:, 2] > 0.3  # farther out the lobe ends at the horizon
    np.testing.assert_allclose(np.median(image[inner] / expected[inner]), 1.0, rtol=2e-3)
    factor = exposure(expected, inner)
    assert psnr(displayed(expected, factor), displayed(image, factor), inner) > 35.0


@pytest.mark.parametrize("lighting", LIGHTINGS)
def test_a_picture_of_half_the_size_looks_the_same(plastic: Measurement, lighting: str) -> None:
    large = render_sphere(plastic, lighting=lighting, size=128)
    small = render_sphere(plastic, lighting=lighting, size=64)
    _, mask = sphere_normals(128)
    whole = np.asarray(mask.reshape(64, 2, 64, 2).all(axis=(1, 3)))
    averaged = large.reshape(64, 2, 64, 2, 3).mean(axis=(1, 3))
    factor = exposure(small, whole)
    assert psnr(displayed(small, factor), displayed(averaged, factor), whole) > 38.0


@pytest.mark.parametrize("lighting", LIGHTINGS)
def test_exchanging_the_directions_changes_nothing(plastic: Measurement, lighting: str) -> None:
    evaluate = interpolate(plastic).evaluate
    exchanged = render_sphere(lambda a, b, c: evaluate(a, b, c + np.pi), lighting=lighting, size=32)
    np.testing.assert_allclose(exchanged, render_sphere(plastic, lighting=lighting, size=32), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("lighting", LIGHTINGS)
def test_measurement_model_and_function_are_taken_alike(plastic: Measurement, lighting: str) -> None:
    interpolated = interpolate(plastic)
    image = render_sphere(plastic, lighting=lighting, size=17)
    np.testing.assert_array_equal(render_sphere(interpolated, lighting=lighting, size=17), image)
    np.testing.assert_array_equal(render_sphere(interpolated.evaluate, lighting=lighting, size=17), image)
    _, mask = sphere_normals(17)
    assert image.shape == (17, 17, 3)
    assert (image[~mask] == 0.0).all()
    assert (image[mask] > 0.0).all(axis=-1).mean() > 0.9


def test_likeness_is_that_of_the_exposed_pictures(plastic: Measurement) -> None:
    reference = render_sphere(plastic, size=32)
    assert sphere_likeness(reference, reference) == pytest.approx((float("inf"), 1.0))
    noise, likeness = sphere_likeness(reference, 1.1 * reference)
    assert sphere_likeness(3.0 * reference, 3.3 * reference) == pytest.approx((noise, likeness))
    assert 20.0 < noise < 40.0
    assert sphere_likeness(reference, 1.5 * reference) < (noise, likeness)


def test_what_cannot_be_rendered_is_refused() -> None:
    with pytest.raises(InvalidArgumentError, match="lighting must be one of three_lights, environment, not 'moon'"):
        render_sphere(lambertian, lighting="moon")
    for size in (7, 1025, 64.0):
        with pytest.raises(InvalidArgumentError, match=f"from 8 to 1024 pixels, not {size}"):
            render_sphere(lambertian, size=size)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgumentError, match="not int"):
        render_sphere(3)  # type: ignore[arg-type]
