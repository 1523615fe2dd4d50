"""Tables with wavelengths: as rows or as columns they become linear sRGB."""

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError
from dsbrdf.arrays import Array
from dsbrdf.samples.reading import parse_samples
from dsbrdf.samples.values import linear_srgb
from tests.library.samples.test_reading import ANGLES, COUNT, GREY, check_same, table

DIRECTION = ("theta_in", "phi_in", "theta_out", "phi_out")
VISIBLE = np.arange(400.0, 701.0, 20.0)
# x, y, z of the CIE 1931 observer at these wavelengths, from its table (CIE 015)
OBSERVER = np.array(
    [
        (0.0143, 0.0004, 0.0679), (0.1344, 0.0040, 0.6456), (0.3483, 0.0230, 1.7471), (0.2908, 0.0600, 1.6692),
        (0.0956, 0.1390, 0.8130), (0.0049, 0.3230, 0.2720), (0.0633, 0.7100, 0.0782), (0.2904, 0.9540, 0.0203),
        (0.5945, 0.9950, 0.0039), (0.9163, 0.8700, 0.0017), (1.0622, 0.6310, 0.0008), (0.8544, 0.3810, 0.0002),
        (0.4479, 0.1750, 0.0000), (0.1649, 0.0610, 0.0000), (0.0468, 0.0170, 0.0000), (0.0114, 0.0041, 0.0000),
    ]
)  # fmt: skip


def smooth(wavelengths: Array) -> Array:
    """Spectra of five colors, none far from grey, shape (5, wavelengths)."""
    at = (wavelengths - 550.0) / 150.0
    return np.stack(
        [0.5 + 0.3 * at, 0.5 - 0.3 * at, 0.3 + 0.3 * at**2, 0.7 - 0.3 * at**2, 0.4 + 0.2 * np.sin(3.0 * at)]
    )


def test_colors_are_those_of_the_table_of_the_observer() -> None:
    xyz = smooth(VISIBLE) @ OBSERVER / OBSERVER[:, 1].sum()
    bradford = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    cones = xyz @ bradford.T / (bradford @ np.ones(3)) * (bradford @ [0.95047, 1.0, 1.08883])
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    expected = np.linalg.solve(to_xyz @ np.eye(3), np.linalg.solve(bradford, cones.T)).T
    np.testing.assert_allclose(linear_srgb(VISIBLE, smooth(VISIBLE)), expected, atol=0.015)


@pytest.mark.parametrize("wavelengths", [[450.0, 550.0, 650.0], VISIBLE, [550.0], [300.0, 500.0, 1100.0]])
def test_a_flat_spectrum_is_grey_exactly(wavelengths: list[float]) -> None:
    spectra = np.array([[0.1], [0.7], [3.0]]) * np.ones(len(wavelengths))
    np.testing.assert_array_equal(linear_srgb(np.array(wavelengths), spectra), spectra[:, :1] * np.ones(3))


def test_a_color_outside_of_srgb_is_not_negative() -> None:
    rgb = linear_srgb(VISIBLE, np.exp(-(((VISIBLE[None] - 500.0) / 15.0) ** 2)))
    assert rgb.min() == 0.0 < rgb[0, 1]


FACTORS = smooth(np.array([450.0, 500.0, 550.0, 600.0, 650.0]))[4] * np.array([0.5, 1.0, 1.0, 1.5, 1.0])
SPECTRA = GREY[:, :1] * FACTORS
EXPECTED = linear_srgb(np.array([450.0, 500.0, 550.0, 600.0, 650.0]), SPECTRA)


@pytest.mark.parametrize("name", ["{:g} nm", "{:g}", "BRDF {:g}nm", "R_{:g}", "{:g} [nm]", "λ{:g}"])
def test_wavelengths_as_columns(name: str) -> None:
    names = [name.format(wavelength) for wavelength in (650, 450, 500, 550, 600)]
    samples = parse_samples(table((*DIRECTION, *names), np.hstack([ANGLES, SPECTRA[:, [4, 0, 1, 2, 3]]])))
    check_same(samples, ANGLES, EXPECTED)
    assert samples.notes == (
        "The 5 wavelengths from 450 to 650 nm were made linear sRGB, as the CIE 1931 observer sees them under light of "
        "equal energy; a flat spectrum is grey.",
    )


@pytest.mark.parametrize(
    ("name", "unit"), [("wavelength", 1.0), ("λ (nm)", 1.0), ("Wavelength [µm]", 1e-3), ("wl", 1e-3)]
)
def test_wavelengths_as_rows(name: str, unit: float) -> None:
    nanometres = np.tile([450.0, 500.0, 550.0, 600.0, 650.0], COUNT)[:, None]
    columns = np.hstack([np.repeat(ANGLES, 5, axis=0), nanometres * unit, SPECTRA.reshape(-1, 1)])
    order = np.random.default_rng(3).permutation(len(columns))
    samples = parse_samples(table((*DIRECTION, name, "value"), columns[order]))
    place = {tuple(np.round(row, 6)): i for i, row in enumerate(np.hstack([*_vectors()]))}
    at = [place[tuple(row)] for row in np.round(np.hstack([samples.omega_in, samples.omega_out]), 6)]
    check_same(samples, ANGLES[at], EXPECTED[at])


def _vectors() -> tuple[Array, Array]:
    samples = parse_samples(table())
    return samples.omega_in, samples.omega_out


def test_one_wavelength_is_grey() -> None:
    columns = np.hstack([ANGLES, np.full((COUNT, 1), 632.8), GREY[:, :1]])
    samples = parse_samples(table((*DIRECTION, "wavelength", "value"), columns))
    assert np.ptp(samples.values, axis=1).max() == 0.0
    assert samples.notes == ("All values are at 632.8 nm: the material is taken to be grey.",)


def test_wavelengths_that_cannot_be_a_color_are_told() -> None:
    infrared = table((*DIRECTION, "900 nm", "1000 nm"), np.hstack([ANGLES, GREY[:, :2]]))
    with pytest.raises(MeasurementFormatError, match="wavelengths from 900 to 1000 nm are not visible"):
        parse_samples(infrared)
    columns = np.hstack([ANGLES, np.linspace(400.0, 700.0, COUNT)[:, None], GREY[:, :1]])
    with pytest.raises(MeasurementFormatError, match="have different wavelengths; all need the same ones"):
        parse_samples(table((*DIRECTION, "wavelength", "value"), columns))


MATRIX_IN = np.arange(0.0, 80.0, 15.0)
MATRIX_OUT = np.arange(-80.0, 81.0, 10.0)
MATRIX = 0.1 + np.exp(-(((MATRIX_OUT[:, None] - MATRIX_IN) / 12.0) ** 2))


@pytest.mark.parametrize(
    ("corner", "between"), [("theta_out \\ theta_in", ","), ("AOR/AOI [deg]", ";"), ("viewing angle | AOI", "\t")]
)
def test_a_matrix_of_incidence_against_receiver(corner: str, between: str) -> None:
    lines = [between.join([corner, *(f"{angle:g}" for angle in MATRIX_IN)])]
    lines += [
        between.join(f"{cell:.9g}" for cell in (angle, *row)) for angle, row in zip(MATRIX_OUT, MATRIX, strict=True)
    ]
    samples = parse_samples("\n".join(lines).encode())
    angles = np.array([(a, 180.0, b, 0.0) for b in MATRIX_OUT for a in MATRIX_IN])
    check_same(samples, angles, np.repeat(MATRIX.reshape(-1, 1), 3, axis=1))
