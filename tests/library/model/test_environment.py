"""Panoramas as light: against closed forms and the library's own environment."""

import numpy as np
import pytest

from dsbrdf.errors import ImageFormatError
from dsbrdf.model.environment import SUN, EnvironmentMap, environment_radiance
from dsbrdf.model.render import render_sphere, sphere_normals

ALBEDO = np.array([0.8, 0.5, 0.2])


def lambertian(theta_half: np.ndarray, _theta_diff: np.ndarray, _phi_diff: np.ndarray) -> np.ndarray:
    return ALBEDO / np.pi * np.ones((*theta_half.shape, 1))


def directions_of(height: int) -> np.ndarray:
    """Directions of a panorama's pixels: the middle column is behind the sphere, the right half on the right."""
    up = (np.arange(height) + 0.5)[:, None] * np.pi / height
    turn = ((np.arange(2 * height) + 0.5) / (2 * height) - 0.5) * 2.0 * np.pi
    parts = np.sin(up) * np.sin(turn), np.cos(up) + 0.0 * turn, -np.sin(up) * np.cos(turn)
    return np.stack(parts, axis=-1)


def test_even_light_returns_the_albedo() -> None:
    colour = np.array([1.0, 2.0, 3.0])
    environment = EnvironmentMap.from_pixels(np.broadcast_to(colour, (8, 16, 3)))
    assert environment.lights == ()
    image = render_sphere(lambertian, lighting=environment, size=32)
    _, mask = sphere_normals(32)
    np.testing.assert_allclose(image[mask], np.broadcast_to(ALBEDO * colour, (mask.sum(), 3)), rtol=0.01)


@pytest.mark.parametrize("height", [40, 300])
def test_a_picture_of_the_sky_is_the_sky(height: int) -> None:
    environment = EnvironmentMap.from_pixels(environment_radiance(directions_of(height)))
    expected = render_sphere(lambertian, lighting="environment", size=48)
    lit_by_sun = np.zeros_like(expected)
    normals, mask = sphere_normals(48)
    cosine = np.maximum(normals @ np.array(SUN.direction), 0.0)
    lit_by_sun[mask] = cosine[:, None] * np.array(SUN.irradiance) * ALBEDO / np.pi
    found = render_sphere(lambertian, lighting=environment, size=48)
    np.testing.assert_allclose(found + lit_by_sun, expected, rtol=0.01)


def test_a_small_bright_spot_is_a_distant_light() -> None:
    directions = directions_of(64)
    pixels = np.full(directions.shape, 0.01)
    row, column = 10, 9  # up, to the left, behind the viewer
    pixels[row, column] = 500.0, 400.0, 300.0
    environment = EnvironmentMap.from_pixels(pixels)
    (light,) = environment.lights
    np.testing.assert_allclose(light.direction, directions[row, column], atol=1e-12)
    area = np.sin((row + 0.5) * np.pi / 64) * (np.pi / 64) ** 2
    left = environment.pixels[row, column]
    np.testing.assert_allclose(np.array(light.irradiance) / area + left, pixels[row, column])
    image = render_sphere(lambertian, lighting=environment, size=64)
    brightest = np.unravel_index(image[..., 0].argmax(), (64, 64))
    towards = np.array(light.direction)
    np.testing.assert_allclose(brightest, [32 * (1 - towards[1]), 32 * (1 + towards[0])], atol=2)


def test_a_large_bright_area_stays_in_the_picture() -> None:
    pixels = np.full((32, 64, 3), 0.001)
    pixels[12:16, 30:36] = 1.0
    environment = EnvironmentMap.from_pixels(pixels)
    assert environment.lights == ()
    np.testing.assert_array_equal(environment.pixels, pixels)


@pytest.mark.parametrize(
    ("pixels", "words"),
    [
        (np.ones((4, 4, 3)), r"twice as wide as high, unlike one of the shape \(4, 4, 3\)"),
        (np.ones((4, 8)), "twice as wide as high"),
        (np.zeros((4, 8, 3)), "is black"),
        (-np.ones((4, 8, 3)), "finite and not negative"),
        (np.full((4, 8, 3), np.nan), "finite and not negative"),
    ],
)
def test_what_is_no_panorama_is_refused(pixels: np.ndarray, words: str) -> None:
    with pytest.raises(ImageFormatError, match=words):
        EnvironmentMap.from_pixels(pixels)
