"""Tables with what laboratories leave in them, of known truth: read right, and told what is wrong and what helps."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError, ScatteredSamples, TableOptions, read_samples
from dsbrdf.arrays import Array
from dsbrdf.data import CHANNELS, half_difference
from dsbrdf.samples.doubts import sample_doubts
from dsbrdf.samples.reading import parse_samples
from tests.library.samples.test_layouts import truth
from tests.library.samples.test_reading import ANGLES, DIRECTION, spherical, table
from tests.support.reproduced import assert_reproduced, digest

GRID = np.array([(a, 180.0, b, p) for a in (15.0, 40.0, 65.0) for b in range(0, 86, 5) for p in range(0, 181, 20)])
"""theta_in, phi_in, theta_out, phi_out [degrees]."""
TRUE = 0.1 * truth(*spherical(GRID))[:, 0]
"""A dark, rough material [1/sr]."""


UNEVEN = GRID + np.random.default_rng(6).uniform(0.0, 3.0, GRID.shape)  # No two samples have one theta_half.
COSINE_IN = np.cos(np.radians(UNEVEN[:, :1]))
COSINE_OUT = np.cos(np.radians(GRID[:, 2]))
ROWS = np.arange(len(GRID))
NINTH = ROWS % 9 == 0
TWENTIETH = ROWS % 20 == 0
HALF = half_difference(*spherical(GRID))[0]
IS_MIRROR = HALF < 1e-4
CLIPPED = np.minimum(TRUE, np.quantile(TRUE, 0.9))
FALLING = 0.02 * np.exp(-GRID[:, 2] / 9.0)
UNSEEN = GRID[:, 2] > 0.9 * 85.0 - 0.1 * GRID[:, 3] / 20.0
NOISE = np.random.default_rng(2).standard_normal(len(TRUE))
BANDS = np.arange(400.0, 701.0, 20.0)
LASER = np.exp(-(((BANDS - 520.0) / 12.0) ** 2))
SPECTRUM = [f"{band:g} nm" for band in BANDS]
AT_15 = GRID[:, 0] == 15.0
GRAZING = (GRID[:, 0] == 65.0) & (GRID[:, 2] >= 55.0)
ANYWHERE = ANGLES * [1.0, 0.0, 1.0, 1.0] + [0.0, 180.0, 0.0, 0.0]
CLOSE_INCIDENCES = np.vstack([GRID, np.add(GRID, [5.0, 0.0, 0.0, 0.0])])
TOWARDS_LIGHT = np.sum(np.prod(spherical(CLOSE_INCIDENCES), axis=0), axis=1).clip(0.0)
IN_PLANE = np.array([(a, 180.0, b, 0.0) for a in (20.0, 30.0) for b in np.arange(-80.0, 81.0, 2.5)])


def highlight(grid: Array, width: float) -> Array:
    return np.asarray(np.exp(-((half_difference(*spherical(grid))[0] / width) ** 2)))


TABLES: dict[str, tuple[Array, Array, Sequence[str]]] = {
    "good": (GRID, TRUE, ["value"]),
    "equal peaks": (CLOSE_INCIDENCES, 0.01 + 0.04 * highlight(CLOSE_INCIDENCES, 0.06), ["value"]),
    "equal at grazing thetas": (GRID, 0.1 * np.prod(np.cos(np.radians(GRID[:, ::2])), axis=1) ** -0.3, ["value"]),
    "equal towards the light": (CLOSE_INCIDENCES, 0.1 + TOWARDS_LIGHT**200.0, ["value"]),
    "clipped": (GRID, CLIPPED, ["value"]),
    "few levels": (GRID, CLIPPED.round(2), ["value"]),
    "one sample in each highlight": (GRID, np.where(IS_MIRROR, 90.0, TRUE), ["value"]),
    "a glint at one incidence": (GRID, np.where(IS_MIRROR & AT_15, 90.0, TRUE), ["value"]),
    "none in the highlight": (GRID[HALF > 0.07], np.where(HALF < 0.0875, 90.0, TRUE)[HALF > 0.07], ["value"]),
    "hardly any incidence occurs twice": (
        np.vstack([GRID[AT_15], ANYWHERE]),
        np.append(np.where(IS_MIRROR, 90.0, TRUE)[AT_15], 0.1 * truth(*spherical(ANYWHERE))[:, 0]),
        ["value"],
    ),
    "one stray sample": (
        np.vstack([GRID[GRAZING], [15.0, 180.0, 80.0, 60.0]]),
        np.append(np.full(GRAZING.sum(), 0.1), 30.0),
        ["value"],
    ),
    "reflectance factors": (GRID, np.pi * np.minimum(9.0 * TRUE, 0.3), ["value"]),
    "per cent times cosine": (UNEVEN, 10.0 * np.pi * truth(*spherical(UNEVEN)) * COSINE_IN, CHANNELS),
    "per cent": (GRID, 100.0 * np.pi * TRUE, ["value"]),
    "integers": (GRID, np.rint(3e4 * TRUE), ["value"]),
    "bytes": (GRID, np.rint(255.0 * (TRUE / TRUE.max()) ** 0.45), ["value"]),
    "times cosine": (GRID, TRUE * COSINE_OUT, ["value"]),
    "times cosine, of hardly any weight": (
        GRID,
        np.column_stack([np.where(TWENTIETH, TRUE, TRUE * COSINE_OUT), np.where(TWENTIETH, 1.0, 1e-5)]),
        ["value", "weight"],
    ),
    "a drift": (
        IN_PLANE,
        (0.1 + 3.0 * highlight(IN_PLANE, 0.1)) * np.where(IN_PLANE[:, 0] < 25.0, 0.85, 1.0),
        ["value"],
    ),
    "noise": (GRID, TRUE + 2e-3 * NOISE, ["value"]),
    "noise below zero": (GRID, np.where(ROWS // 2 == 3, -1e-4, TRUE), ["value"]),
    "noise of a black sample": (GRID, np.maximum(2e-4 + 3e-4 * NOISE, 0.0), ["value"]),
    "noise of a grey spectrum": (GRID, np.where(ROWS == 55, -1e-4, TRUE)[:, None] * np.ones(BANDS.size), SPECTRUM),
    "few digits of a black sample": (GRID, FALLING.round(4), ["value"]),
    "zeros": (GRID, np.where(GRID[:, 2] > 70.0, 0.0, TRUE), ["value"]),
    "zeros beyond the reach": (GRID, np.where(UNSEEN, 0.0, TRUE), ["value"]),
    "zeros below a floor": (GRID, np.where(FALLING < 5e-5, 0.0, FALLING), ["value"]),
    "a code": (GRID, np.where(NINTH, 99999.0, TRUE), ["value"]),
    "a code of 0": (GRID, np.where(NINTH[:, None] * [1, 0, 0], 0.0, 0.5 + TRUE[:, None]), CHANNELS),
    "a code of -1": (GRID, np.where(ROWS < 3, -1.0, TRUE), ["value"]),
    "negative code": (GRID, np.where(NINTH, -9999.0, TRUE), ["value"]),
    "negative code in one row": (GRID, np.where(ROWS == 3, -9999.0, TRUE), ["value"]),
    "no numbers": (GRID, np.where(NINTH, np.nan, TRUE), ["value"]),
    "two levels": (GRID, np.where(GRID[:, 0] < 30.0, 4.0, 1.0) * TRUE, ["value"]),
    "back to the light": (GRID * [1.0, 0.0, 1.0, 1.0], TRUE, ["value"]),
    "below the horizon": (np.add(GRID, [12.0, 0.0, 12.0, 0.0]), TRUE, ["value"]),
    "twice": (np.vstack([GRID, GRID[:9]]), np.append(TRUE, 2.0 * TRUE[:9]), ["value"]),
    "nearly twice": (
        np.vstack([GRID, GRID[:9] - [0.0, 360.0, 0.0, 360.0]]),
        np.append(TRUE, 1.2 * TRUE[:9]),
        ["value"],
    ),
    "a laser": (GRID, TRUE[:, None] * LASER, SPECTRUM),
    "dark": (GRID, 1e-5 * TRUE[:, None] * [1.0, 1.0, 0.0], CHANNELS),
}


@pytest.mark.parametrize("kind", TABLES)
def test_what_is_read_and_said_of_a_table(kind: str) -> None:
    grid, values, names = TABLES[kind]
    samples = parse_samples(table([*DIRECTION, *names], np.column_stack([grid, values])))
    doubts = sample_doubts(samples)
    said = [*samples.notes, *(asdict(one) for one in doubts.findings), digest(samples.values), doubts.factor]
    assert_reproduced(f"doubts/{kind}", said)


def read(values: Array, grid: Array = GRID) -> ScatteredSamples:
    return parse_samples(table([*DIRECTION, "value"], np.column_stack([grid, values])))


def test_a_pair_of_directions_may_be_turned_about_the_normal() -> None:
    """Materials are isotropic: whatever azimuth the lamp has, rows are left out and doubted alike."""
    turn = np.random.default_rng(3).uniform(0.0, 360.0, (len(GRID), 1)).round(3)
    turned = (GRID + turn * [0.0, 1.0, 0.0, 1.0]) % 360.0
    for values in (TRUE, np.where(UNSEEN, 0.0, TRUE), CLIPPED, 100.0 * np.pi * TRUE):
        samples, other = read(values), read(values, grid=turned)
        np.testing.assert_array_equal(other.values, samples.values)
        assert other.notes == samples.notes
        assert sample_doubts(other).sentences == sample_doubts(samples).sentences


def test_exchanged_angles_are_told_with_the_option_that_exchanges_them() -> None:
    content = table(("phi_i", "theta_i", "phi_o", "theta_o", "brdf"), np.column_stack([GRID, TRUE]))
    said = "exchanged, name them, as in --columns theta_in=phi_i,theta_out="
    with pytest.raises(MeasurementFormatError, match=said) as caught:
        parse_samples(content)
    option = str(caught.value).rpartition(" ")[2].rstrip(".")
    samples = parse_samples(content, options=TableOptions(columns=option))
    np.testing.assert_allclose(samples.omega_out, spherical(GRID)[1], atol=1e-9)


def test_colours_in_cie_xyz_are_read() -> None:
    white, red = np.array([0.9505, 1.0, 1.089]), np.array([0.4124, 0.2126, 0.0193])  # IEC 61966-2-1.
    for colour, expected in ((white, [1.0, 1.0, 1.0]), (red, [1.0, 0.0, 0.0])):
        at_40 = GRID[:, 0] == 40.0
        columns = np.column_stack([GRID[at_40, 2:], TRUE[at_40, None] * colour])
        head = "#incident_angle 40 180\n#colorimetry: CIE-XYZ\n"
        pgii = parse_samples(table("#format: theta phi BSDF", columns, between=" ", before=head))
        named = parse_samples(table((*DIRECTION, "X", "Y", "Z"), np.column_stack([GRID, TRUE[:, None] * colour])))
        np.testing.assert_allclose(pgii.values, TRUE[at_40, None] * expected, atol=2e-4 * TRUE.max())
        np.testing.assert_allclose(named.values, TRUE[:, None] * expected, atol=2e-4 * TRUE.max())


def test_the_example_of_columns_reads_the_table() -> None:
    scan = table("", np.column_stack([GRID[:, 2:], TRUE])[GRID[:, 0] == 40.0], between=" ")
    with pytest.raises(MeasurementFormatError) as caught:
        parse_samples(scan)
    example = str(caught.value).partition("--columns ")[2].split(" ")
    assert example[:3] == ["theta_out=1,phi_out=2,value=3", "--constants", "theta_in=30"]
    assert len(parse_samples(scan, options=TableOptions(columns=example[0], constants=example[2])).values) == 180


def test_files_of_one_material_are_told_of_together(tmp_path: Path) -> None:
    paths = [tmp_path / f"at{angle:g}.txt" for angle in (15.0, 40.0)]
    for path, angle in zip(paths, (15.0, 40.0), strict=True):
        rows = np.column_stack([GRID[:, 2:], TRUE])[GRID[:, 0] == angle]
        low = [[95.0, 0.0, 0.1]] if angle == 15.0 else [[95.0, 0.0, 0.1], [91.0, 0.0, 0.1]]
        columns = np.vstack([rows, low])
        path.write_bytes(table("#format: theta phi BSDF", columns, between=" ", before=f"#intheta {angle}\n"))
    samples = read_samples(paths)
    assert len(samples.values) == 360
    assert "3 rows have a direction at or below the horizon; they are left out." in samples.notes
    assert not any("15" in note or "40" in note for note in samples.notes)
    paths[1].write_bytes(table((*DIRECTION, *CHANNELS), np.column_stack([GRID, TRUE, TRUE, 0.5 * TRUE])))
    with pytest.raises(MeasurementFormatError, match=r"The file at15\.txt has one column of values, and other files"):
        read_samples(paths)
