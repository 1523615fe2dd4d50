"""Options that say of a table what it does not say itself, and wavelengths that become linear sRGB."""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import dsbrdf
from dsbrdf import InvalidArgumentError, TableOptions
from dsbrdf.arrays import Array
from dsbrdf.data.merl_validation import HEADER
from dsbrdf.samples.cells import as_number
from dsbrdf.samples.names import constants_in, wavelength_of
from dsbrdf.samples.reading import parse_samples
from dsbrdf.samples.values import linear_srgb
from tests.library.samples.test_reading import ANGLES, COUNT, DIRECTION, GREY, RGB, check_same, spherical, table

NAMED = {"theta_in": "AOI 1", "phi_in": "turn", "theta_out": "Arm", "phi_out": "tilt", "value": "Signal"}
ODD = table(list(NAMED.values()), np.hstack([ANGLES, GREY[:, :1]]))


@pytest.mark.parametrize("columns", [NAMED, ",".join(f"{meaning}={name.upper()}" for meaning, name in NAMED.items())])
def test_columns_are_named(columns: str) -> None:
    check_same(parse_samples(ODD, options=TableOptions(columns=columns)), ANGLES, GREY)


def test_a_column_that_is_named_counts_alone() -> None:
    columns = np.hstack([ANGLES, 2.0 * GREY[:, :1], GREY[:, :1]])
    samples = parse_samples(table((*DIRECTION, "BSDF", "BRDF"), columns), options=TableOptions(columns="value=BRDF"))
    check_same(samples, ANGLES, GREY)
    swapped = TableOptions(columns="theta_in=theta_out,theta_out=theta_in,phi_in=phi_out,phi_out=phi_in")
    check_same(parse_samples(table(), options=swapped), ANGLES[:, [2, 3, 0, 1]], RGB)
    check_same(parse_samples(table(), options=TableOptions(constants="theta_in=5")), ANGLES, RGB)


@pytest.mark.parametrize(("side", "cosine"), [("in", 0), ("out", 2)])
def test_values_are_multiplied_and_divided_and_the_plane_is_turned(side: Literal["in", "out"], cosine: int) -> None:
    samples = parse_samples(table(), options=TableOptions(scale=0.01, cosine=side, phi="mirror"))
    turned = np.add(ANGLES, [0.0, 180.0, 0.0, 0.0])
    check_same(samples, turned, 0.01 * RGB / np.cos(np.radians(ANGLES[:, [cosine]])))


def test_a_mirror_direction_with_the_same_phi_is_turned() -> None:
    in_plane = ANGLES * [1.0, 0.0, 1.0, 0.0] + [0.0, 180.0, 0.0, 0.0]
    turned = table(("theta_in", "theta_out", "red", "green", "blue"), np.hstack([ANGLES[:, ::2] * [-1, 1], RGB]))
    samples = parse_samples(turned, options=TableOptions(phi="mirror"))
    check_same(samples, in_plane, RGB)
    assert "theta_out = -theta_in to be the mirror direction" in samples.notes[0]


def test_a_file_is_read_with_options_and_a_grid_has_none(tmp_path: Path) -> None:
    path = tmp_path / "paint.csv"
    path.write_bytes(table())
    samples = dsbrdf.read_measurement(path, scale=0.5)
    check_same(samples, ANGLES, 0.5 * RGB)  # type: ignore[arg-type]
    (tmp_path / "paint.bin").write_bytes(HEADER + bytes(99))
    for options in (TableOptions(scale=0.5), TableOptions(scale=0.5, missing=0)):
        with pytest.raises(InvalidArgumentError, match=r"of a table of samples, and this is a MERL file: leave"):
            dsbrdf.fit(tmp_path / "paint.bin", scale=0.5, missing=options.missing)


def test_numbers_in_names_and_lines_are_wavelengths_and_angles_where_they_can_be() -> None:
    names = ("450 nm", "0.45um", "brdf_450nm", "199 nm", "3001 nm")
    assert [wavelength_of(name) for name in names] == [450.0, 450.0, 450.0, None, None]
    numbers = ("1,234.5", "1'234.5", "1\N{NARROW NO-BREAK SPACE}234,5", "1 234.5", "1,234")
    assert [as_number(number) for number in numbers] == [1234.5, 1234.5, 1234.5, None, 1.234]
    assert constants_in("AOI [deg]: 30") == {"theta_in [deg]": 30.0}
    assert constants_in("incident_angle 30 180") == {"theta_in": 30.0, "phi_in": 180.0}
    assert [constants_in(line) for line in ("AOI 30 60", "temperature 20", "phi_in zero")] == [{}, {}, {}]


@pytest.mark.parametrize("name", ["BRDF*cos", "BRDF * cos(θ_r)", "f_r·cos θ_o"])
def test_values_named_as_a_product_are_divided_by_the_cosine(name: str) -> None:
    values = GREY[:, :1] * np.cos(np.radians(ANGLES[:, 2:3]))
    check_same(parse_samples(table((*DIRECTION, name), np.hstack([ANGLES, values]))), ANGLES, GREY)


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
    at = (wavelengths - 550.0) / 150.0
    wave, line, curve = 0.4 + 0.2 * np.sin(3.0 * at), 0.3 * at, 0.3 * at**2
    return np.stack([0.5 + line, 0.5 - line, 0.3 + curve, 0.7 - curve, wave])


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
    ("name", "unit"), [("wavelength", 1.0), ("λ (nm)", 1.0), ("Wavelength [µm]", 1e-3), ("wl [Å]", 10.0)]
)
def test_wavelengths_as_rows(name: str, unit: float) -> None:
    nanometres = np.tile([450.0, 500.0, 550.0, 600.0, 650.0], COUNT)[:, None]
    columns = np.hstack([np.repeat(ANGLES, 5, axis=0), nanometres * unit, SPECTRA.reshape(-1, 1)])
    order = np.random.default_rng(3).permutation(len(columns))
    samples = parse_samples(table((*DIRECTION, name, "value"), columns[order]))
    place = {tuple(np.round(row, 6)): i for i, row in enumerate(np.hstack(spherical(ANGLES)))}
    at = [place[tuple(row)] for row in np.round(np.hstack([samples.omega_in, samples.omega_out]), 6)]
    check_same(samples, ANGLES[at], EXPECTED[at])
