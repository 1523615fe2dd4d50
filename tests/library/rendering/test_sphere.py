"""Lit spheres against closed forms and plain sums, pictures of the sky, and the space of materials."""

import struct
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from dsbrdf import EnvironmentMap, InvalidArgumentError, Measurement, blend, read_environment, render_sphere, space
from dsbrdf.components import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.data import half_difference, incident_cosines
from dsbrdf.errors import ImageFormatError
from dsbrdf.rendering import LIGHTINGS, THREE_LIGHTS, MaterialSpace, displayed, exposure, psnr, sphere_normals, ssim
from dsbrdf.rendering.environment import Light
from dsbrdf.rendering.sphere import SUN, environment_radiance
from tests.support.models import single_lobe
from tests.support.renderers import mitsuba_variant
from tests.support.reproduced import assert_reproduced

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
    row, column = np.nonzero(mask)
    np.testing.assert_allclose(normals[:, 0], (column + 0.5) / 20 - 1.0, atol=1e-12)
    np.testing.assert_allclose(normals[:, 1], 1.0 - (row + 0.5) / 20, atol=1e-12)
    assert (normals[:, 2] > 0.0).all()


def lambertian_sphere(light: Light, size: int) -> np.ndarray:
    normals, mask = sphere_normals(size)
    image = np.zeros((size, size, 3))
    image[mask] = np.maximum(np.outer(normals @ light.direction, light.irradiance), 0.0) * ALBEDO / np.pi
    return image


def test_a_lambertian_sphere_under_three_lights_has_a_closed_form() -> None:
    expected = sum(lambertian_sphere(light, 50) for light in THREE_LIGHTS)
    np.testing.assert_allclose(render_sphere(lambertian, size=50), expected, rtol=1e-12)


@pytest.mark.parametrize(("evaluate", "tolerance"), [(lambertian, 0.006), (glossy, 0.015)])
def test_the_environment_is_summed_up(evaluate: Evaluate, tolerance: float) -> None:
    image = render_sphere(evaluate, lighting="environment", size=64)
    normals, mask = sphere_normals(64)
    chosen = np.linspace(0, len(normals) - 1, 12).astype(int)
    expected = np.array([gathered_radiance(normal, evaluate) for normal in normals[chosen]])
    np.testing.assert_allclose(image[mask][chosen], expected, rtol=tolerance, atol=0.1 * tolerance * expected.max())


def test_a_mirror_shows_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dsbrdf.rendering.sphere.SUN", Light(SUN.direction, (0.0, 0.0, 0.0)))
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
def test_measurement_model_and_function_are_taken_alike(plastic: Measurement, lighting: str) -> None:
    interpolated = plastic.interpolated
    image = render_sphere(plastic, lighting=lighting, size=17)
    np.testing.assert_array_equal(render_sphere(interpolated, lighting=lighting, size=17), image)
    np.testing.assert_array_equal(render_sphere(interpolated.evaluate, lighting=lighting, size=17), image)
    _, mask = sphere_normals(17)
    assert image.shape == (17, 17, 3)
    assert (image[~mask] == 0.0).all()
    assert (image[mask] > 0.0).all(axis=-1).mean() > 0.9


def directions_of(height: int) -> np.ndarray:
    """Directions of a panorama's pixels: the middle column is behind the sphere, the right half on the right."""
    up = (np.arange(height) + 0.5)[:, None] * np.pi / height
    turn = ((np.arange(2 * height) + 0.5) / (2 * height) - 0.5) * 2.0 * np.pi
    parts = np.sin(up) * np.sin(turn), np.cos(up) + 0.0 * turn, -np.sin(up) * np.cos(turn)
    return np.stack(parts, axis=-1)


@pytest.mark.parametrize("height", [40, 300])
def test_a_picture_of_the_sky_is_the_sky(height: int) -> None:
    environment = EnvironmentMap.from_pixels(environment_radiance(directions_of(height)))
    expected = render_sphere(lambertian, lighting="environment", size=48)
    found = render_sphere(lambertian, lighting=environment, size=48)
    np.testing.assert_allclose(found + lambertian_sphere(SUN, 48), expected, rtol=0.01)


@pytest.mark.parametrize("height", [20, 330])
def test_a_mirrored_material_under_a_mirrored_panorama_is_mirrored(height: int) -> None:
    pixels = np.random.default_rng(height).uniform(0.5, 1.5, (height, 2 * height, 3))
    pixels[[0, -1]] = 1.0  # straight up and down, where all columns meet
    first = render_sphere(glossy, lighting=EnvironmentMap.from_pixels(pixels), size=24)
    mirrored = EnvironmentMap.from_pixels(pixels[:, ::-1])
    second = render_sphere(lambda half, diff, phi: glossy(half, diff, -phi), lighting=mirrored, size=24)
    np.testing.assert_allclose(second, first[:, ::-1], rtol=1e-9)


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


def test_what_is_no_small_bright_spot_stays_in_the_picture() -> None:
    faint, large = np.ones((64, 128, 3)), np.full((32, 64, 3), 0.001)
    faint[16, 20], large[12:16, 30:36] = 14.0, 1.0
    for pixels in (faint, large):
        environment = EnvironmentMap.from_pixels(pixels)
        assert environment.lights == ()
        np.testing.assert_array_equal(environment.pixels, pixels)


def images(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    reference = generator.uniform(size=(14, 17, 3))
    image = np.clip(reference + 0.1 * generator.standard_normal(reference.shape), 0.0, 1.0)
    return reference, image, generator.uniform(size=reference.shape[:2]) > 0.3


def test_psnr_is_that_of_the_pixels_in_the_mask() -> None:
    reference, _, mask = images()
    for error, decibels in ((0.1, 20.0), (1e-3, 60.0), (0.0, np.inf)):
        image = np.where(mask[..., None], reference + error, 0.0)
        assert psnr(reference, image, mask) == pytest.approx(decibels)


def test_ssim_is_that_of_windows_one_by_one() -> None:
    reference, image, mask = images()
    offsets = np.arange(-5, 6)
    window = np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2.0 * 1.5**2))
    padded = (np.pad(picture, ((5, 5), (5, 5), (0, 0))) for picture in (reference, image))
    a, b = (sliding_window_view(one, (11, 11), axis=(0, 1))[mask].reshape(-1, 121) for one in padded)
    likeness = []
    for in_a, in_b in zip(a, b, strict=True):
        mean_a, mean_b = (np.average(part, weights=window.ravel()) for part in (in_a, in_b))
        (var_a, covariance), (_, var_b) = np.cov(in_a, in_b, aweights=window.ravel(), ddof=0)
        means = (2 * mean_a * mean_b + 1e-4) / (mean_a**2 + mean_b**2 + 1e-4)
        likeness.append(means * (2 * covariance + 9e-4) / (var_a + var_b + 9e-4))
    assert ssim(reference, image, mask) == pytest.approx(np.mean(likeness), rel=1e-10)
    assert ssim(reference, reference, mask) == pytest.approx(1.0, abs=1e-12)


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


PANORAMA = np.random.default_rng(0).uniform(0.5, 1.0, (64, 128, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def mitsuba() -> ModuleType:
    pytest.importorskip("OpenEXR")
    return mitsuba_variant("scalar_rgb")


def written(mitsuba: ModuleType, image: NDArray[np.floating[Any]], path: Path) -> Path:
    mitsuba.Bitmap(image.astype(np.float32)).write(str(path))
    return path


def test_panoramas_by_another_program_are_read_and_values_below_0_become_0(mitsuba: ModuleType, tmp_path: Path) -> None:
    with_alpha = np.concatenate([PANORAMA, np.ones((64, 128, 1), np.float32)], axis=2)
    negative = PANORAMA * np.where(np.arange(128) % 2, 1.0, -1.0)[:, np.newaxis]
    for image, expected in ((PANORAMA, PANORAMA), (with_alpha, PANORAMA), (negative, np.maximum(negative, 0.0))):
        found = read_environment(written(mitsuba, image, tmp_path / "a.exr"))
        np.testing.assert_array_equal(found.pixels, expected)


def test_damaged_files_are_refused(mitsuba: ModuleType, tmp_path: Path) -> None:
    whole = written(mitsuba, PANORAMA, tmp_path / "a.exr").read_bytes()
    (tmp_path / "b.exr").write_bytes(whole[:-40])
    (tmp_path / "c.exr").write_bytes(whole[:4] + struct.pack("<I", 2) + bytes(100))
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\n\n-Y 4 +X 8\n")
    with pytest.raises(ImageFormatError, match=r"must be an OpenEXR picture; save it as \.exr"):
        read_environment(tmp_path / "a.hdr")
    for name in ("b.exr", "c.exr"):
        with pytest.raises(ImageFormatError, match="damaged or cut off"):
            read_environment(tmp_path / name)
    with pytest.raises(ImageFormatError, match="values from 0 to"):
        read_environment(written(mitsuba, np.where(PANORAMA > 0.9, np.inf, PANORAMA), tmp_path / "d.exr"))
    with pytest.raises(ImageFormatError, match="has the channels Y, not R, G and B"):
        read_environment(written(mitsuba, PANORAMA[..., :1], tmp_path / "e.exr"))


def coated(alpha: float, color: tuple[float, float, float] = (0.4, 0.2, 0.1)) -> LayeredModel:
    surface = SpecularLayer((0.05,) * 3, 1.0, alpha, 2.0, (0.0, 0.0), 0.5, 0.0)
    return LayeredModel((surface, DiffuseLayer(color, (0.0,) * 6)))


MODELS = {f"alpha {alpha}": coated(alpha) for alpha in (0.05, 0.1, 0.2, 0.4)}


@pytest.fixture(scope="module")
def materials() -> MaterialSpace:
    matte = LayeredModel((DiffuseLayer((0.4, 0.4, 0.4), (0.0,) * 6),))
    darker = LayeredModel((DiffuseLayer((0.04, 0.01, 0.02), (0.0,) * 6),))
    return space({**MODELS, "matte": matte, "darker": darker})


def test_distances_are_those_of_roughness_not_of_colour(materials: MaterialSpace) -> None:
    np.testing.assert_allclose(materials.distance, materials.distance.T)
    assert materials.nearest("matte")[0][0] == "darker"
    polished = materials.names.index("alpha 0.05")
    assert 0.03 < materials.distance[materials.names.index("matte"), polished] < 0.3
    assert materials.nearest("matte", 1)[0][1] > 50.0  # The same but for colour and brightness, of coloured lights.
    assert [name for name, _ in materials.nearest("alpha 0.05", 2)] == ["alpha 0.1", "alpha 0.2"]
    likeness = [db for _, db in materials.nearest("alpha 0.4", 5)]
    assert likeness == sorted(likeness, reverse=True)
    index = materials.names.index
    assert likeness[0] == pytest.approx(-20 * np.log10(materials.distance[index("alpha 0.4"), index("matte")]))


def test_map_lays_out_a_series_in_its_order_with_gloss_to_the_right(materials: MaterialSpace) -> None:
    across = [materials.places[materials.names.index(name), 0] for name in (*MODELS, "matte")]
    assert across == sorted(across, reverse=True)


def test_midpoint_lies_between_its_ends() -> None:
    ends = coated(0.05, (0.05, 0.1, 0.3)), single_lobe(1.5, 1.0, 0.3)
    found = space({"a": ends[0], "middle": blend(*ends, 0.5), "b": ends[1]}).distance
    assert max(found[0, 1], found[1, 2]) < 0.8 * found[0, 2]


def test_few_materials_and_islands() -> None:
    assert space({"one": MODELS["alpha 0.1"]}).places.tolist() == [[0.0, 0.0]]
    twins = space({"one": MODELS["alpha 0.1"], "twin": MODELS["alpha 0.1"]})
    assert twins.nearest("one") == [("twin", np.inf)]


REFUSED: dict[str, Any] = {
    "an unknown lighting": lambda: render_sphere(lambertian, lighting="moon"),
    "a sphere of 7 pixels": lambda: render_sphere(lambertian, size=7),
    "a sphere of 1025 pixels": lambda: render_sphere(lambertian, size=1025),
    "a sphere of 64.0 pixels": lambda: render_sphere(lambertian, size=cast(Any, 64.0)),
    "a number to render": lambda: render_sphere(cast(Any, 3)),
    "a square panorama": lambda: EnvironmentMap.from_pixels(np.ones((4, 4, 3))),
    "a grey panorama": lambda: EnvironmentMap.from_pixels(np.ones((4, 8))),
    "a black panorama": lambda: EnvironmentMap.from_pixels(np.zeros((4, 8, 3))),
    "a negative panorama": lambda: EnvironmentMap.from_pixels(-np.ones((4, 8, 3))),
    "a panorama that is NaN": lambda: EnvironmentMap.from_pixels(np.full((4, 8, 3), np.nan)),
    "a lost neighbour": lambda: space(MODELS).nearest("three"),
    "a space of nothing": lambda: space({}),
    "a space with a black material": lambda: space({"black": single_lobe(1.0, 1.0, 0.0)}),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_rendered_or_laid_out_is_refused(what: str) -> None:
    with pytest.raises((InvalidArgumentError, ImageFormatError)) as caught:
        REFUSED[what]()
    assert_reproduced(f"refused/{what}", [type(caught.value).__name__, str(caught.value)])
