"""One table with the names of many people, and forty that are none."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError, ScatteredSamples, read_measurement
from dsbrdf.arrays import Array
from dsbrdf.data import CHANNELS, half_difference
from dsbrdf.samples import cells
from dsbrdf.samples.names import VECTORS, meaning_of
from dsbrdf.samples.reading import parse_samples

COUNT = 240
_RANDOM = np.random.default_rng(5)
ANGLES = _RANDOM.uniform((1.0, 0.0, 1.0, 0.0), (85.0, 360.0, 85.0, 360.0), (COUNT, 4)).round(6)
"""theta_in, phi_in, theta_out, phi_out of the samples [degrees]."""
IN_PLANE = ANGLES * [1.0, 0.0, 1.0, 0.0] * _RANDOM.choice([-1.0, 1.0], (COUNT, 4)) + [0.0, 180.0, 0.0, 0.0]
RGB = _RANDOM.uniform(0.01, 9.0, (COUNT, 3)).round(6)
GREY = np.repeat(RGB[:, :1], 3, axis=1)
DIRECTION = ("theta_in", "phi_in", "theta_out", "phi_out")


def spherical(angles: Array) -> tuple[Array, Array]:
    theta, phi = np.radians(angles[:, ::2]), np.radians(angles[:, 1::2])
    vectors = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    return vectors[:, 0], vectors[:, 1]


def table(
    names: Sequence[str] | str = (*DIRECTION, *CHANNELS),
    columns: Array | None = None,
    *,
    between: str = ",",
    number: Callable[[float], str] = "{:.9g}".format,
    before: str = "",
) -> bytes:
    """Bytes of a table; names are as many as columns, or a whole line."""
    columns = np.hstack([ANGLES, RGB]) if columns is None else columns
    head = names if isinstance(names, str) else between.join(names)
    rows = [between.join(map(number, row)) for row in columns.tolist()]
    return "\n".join([*before.splitlines(), head, *rows, ""]).encode()


def renamed(*names: str) -> bytes:
    return table((*names, *CHANNELS))


def half_and_difference() -> Array:
    return np.degrees(np.stack(half_difference(*spherical(ANGLES)), axis=-1))


ORDER = [6, 0, 5, 2, 4, 1, 3]
ALL = (*DIRECTION, *CHANNELS)
WORDS = table().decode().splitlines()
SPELLINGS = {
    "commas": table(),
    "phi below zero": table(columns=np.hstack([ANGLES - [0.0, 360.0, 0.0, 360.0], RGB])),
    "another order": table([ALL[i] for i in ORDER], np.hstack([ANGLES, RGB])[:, ORDER]),
    "capitals": table(",".join(ALL).upper()),
    "theta_i": renamed("theta_i", "phi_i", "theta_o", "phi_o"),
    "thetaI": renamed("thetaI", "phiI", "thetaO", "phiO"),
    "theta_r": renamed("theta_i", "phi_i", "theta_r", "phi_r"),
    "_deg": renamed(*(f"{name}_deg" for name in DIRECTION)),
    "[deg]": renamed(*(f"{name} [deg]" for name in DIRECTION)),
    "a degree sign": renamed(*(f"{name} (°)" for name in DIRECTION)),
    "_rad": table((*(f"{name}_rad" for name in DIRECTION), *CHANNELS), np.hstack([np.radians(ANGLES), RGB])),
    "[gon]": table((*(f"{name} [gon]" for name in DIRECTION), *CHANNELS), np.hstack([ANGLES / 0.9, RGB])),
    "UTF-16": table().decode().encode("utf-16"),
    "r, g, b": table((*DIRECTION, "R", "G", "B")),
    "brdf_red [1/sr]": table((*DIRECTION, *(f"brdf_{name} [1/sr]" for name in CHANNELS))),
    "unit vectors": table((*VECTORS, *CHANNELS), np.hstack([*spherical(ANGLES), RGB])),
    "half and difference angles": table(
        ("theta_half", "theta_diff", "phi_diff", *CHANNELS), np.hstack([half_and_difference(), RGB])
    ),
    "theta_h": table(("theta_h", "theta_d", "phi_d", *CHANNELS), np.hstack([half_and_difference(), RGB])),
}
ASIDE = ANGLES[:, [1]] + np.abs((ANGLES[:, [3]] - ANGLES[:, [1]] + 180.0) % 360.0 - 180.0)
PHASE = np.degrees(np.arccos(np.sum(np.prod(spherical(ANGLES), axis=0), axis=1, keepdims=True)))
OF_OTHER_TABLES = {
    "phase": (
        np.hstack([ANGLES[:, :3], ASIDE]),
        RGB,
        table((*DIRECTION[:3], "phase", *CHANNELS), np.hstack([ANGLES[:, :3], PHASE, RGB])),
    ),
    "in plane": (IN_PLANE, RGB, table(("theta_in", "theta_out", *CHANNELS), np.hstack([IN_PLANE[:, ::2], RGB]))),
    "one phi": (ANGLES * [1, 0, 1, 1], RGB, table(("theta_in", *ALL[2:]), np.hstack([ANGLES[:, [0, 2, 3]], RGB]))),
    **{
        name: (ANGLES, GREY, table((*DIRECTION, name), np.hstack([ANGLES, GREY[:, :1]])))
        for name in ("value", "BRDF [sr^-1]", "luminance", "f_r", "Leuchtdichtekoeffizient")
    },
}


def check_same(samples: ScatteredSamples, angles: Array, values: Array) -> None:
    found = np.stack(half_difference(samples.omega_in, samples.omega_out))
    expected = np.stack(half_difference(*spherical(angles)))
    apart = np.abs((found - expected + np.pi) % (2.0 * np.pi) - np.pi)
    apart[2] *= np.sin(expected[0]) * np.sin(expected[1])  # phi_diff is any angle where another one is 0
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)
    np.testing.assert_allclose(samples.values, values, rtol=1e-8)


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_every_spelling_of_a_table_is_the_same_samples(spelling: str) -> None:
    samples = parse_samples(SPELLINGS[spelling])
    check_same(samples, ANGLES, RGB)
    np.testing.assert_array_equal(samples.weight, 1.0)
    assert samples.notes == ()


@pytest.mark.parametrize("spelling", OF_OTHER_TABLES)
def test_what_a_table_leaves_out_is_assumed_and_said(spelling: str) -> None:
    angles, values, content = OF_OTHER_TABLES[spelling]
    samples = parse_samples(content)
    check_same(samples, angles, values)
    said = {"in plane": "has no phi", "one phi": "the mirror direction is taken to have phi_out = 180."}
    said["phase"] = "The azimuth follows from the phase angle"
    words = said.get(spelling, "grey")
    assert [words in note for note in samples.notes] == [True]


@pytest.mark.parametrize("suffix", [".TXT", ".binary", ".bsdf", ""])
def test_the_content_tells_a_table(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"felt{suffix}"
    path.write_bytes(table())
    samples = read_measurement(path)
    assert (type(samples), samples.name) == (ScatteredSamples, "felt")


def test_weights_and_columns_that_are_not_read() -> None:
    weight = np.linspace(1.0, 2.0, COUNT)[:, None]
    columns = np.hstack([ANGLES, RGB, weight, weight])
    samples = parse_samples(table((*ALL, "Weight", "temperature"), columns))
    np.testing.assert_allclose(samples.weight, weight[:, 0], rtol=1e-8)
    assert samples.notes == ("The table has a column that was not read: 'temperature'.",)
    words = [f"{line};probe {i}" for i, line in enumerate(table(between=";").decode().splitlines())]
    check_same(parse_samples("\n".join(words).encode()), ANGLES, RGB)


def test_what_is_no_number_is_left_out_and_counted() -> None:
    lines = WORDS.copy()
    lines[3:3] = ["10,0,20,0,nan,1,1", "10,0,20,0,,1,1", "10,0,20,0,1,1,N/A", "10,0,20,0,inf,1,1", "inf,0,20,0,1,1,1"]
    lines[9:9] = ["10,0,90,0,1,1,1", "120,0,20,0,1,1,1"]
    samples = parse_samples("\n".join(lines).encode())
    check_same(samples, ANGLES, RGB)
    assert samples.notes == (
        "5 rows have no finite number in a column that is needed, such as 'red'; they are left out.",
        "2 rows have a direction at or below the horizon; they are left out.",
    )


def test_noise_below_zero_counts_as_zero() -> None:
    values = RGB.copy()
    values[7, 1], values[9, 2] = -0.01, -0.02
    samples = parse_samples(table(columns=np.hstack([ANGLES, values])))
    np.testing.assert_allclose(samples.values, np.maximum(values, 0.0), rtol=1e-8)
    assert samples.notes == (
        f"2 values are negative, down to -{0.02 / RGB.max():.2%} of the largest; they count as 0.",
    )


def changed(place: int, cell: str) -> bytes:
    cells = WORDS[5].split(",")
    cells[place] = cell
    return "\n".join([*WORDS[:5], ",".join(cells), *WORDS[6:]]).encode()


def zemax(incidence: bytes, azimuth: bytes, radial: bytes, values: bytes) -> bytes:
    angles = zip((b"AngleOfIncidence", b"ScatterAzimuth", b"ScatterRadial"), (incidence, azimuth, radial), strict=True)
    lists = b"".join(b"%b %d\n%b\n" % (name, len(told.split()), told) for name, told in angles)
    return b"SampleRotation 1\n0\n" + lists + b"DataBegin\n" + values + b"\n"


OFF_UNIT = np.hstack([spherical(ANGLES)[0] * 1.05, spherical(ANGLES)[1], RGB])
NO_Z = table((*VECTORS[:5], "z", *CHANNELS), np.hstack([*spherical(ANGLES), RGB]))
WRONG = [
    (WORDS[0].encode(), "There are 0 samples; a fit needs at least "),
    ("\n".join(WORDS[:40]).encode(), "There are 39 samples; a fit needs at least 50."),
    (table() + b"1;" * 70_000, "Line 242 of the table has 140000 characters; it may have at most 131072."),
    (table() + b"1," * 65_000, "Line 242 of the table has 65001 cells, and the line of names has 7"),
    (b"theta_in," * 4097 + b"\n1", "The table has 4097 columns; it may have at most 4096."),
    (WORDS[0].encode() + b"\n,,,,,,\n" * 7150, "has 7150 rows of 7 cells; it may have at most 50000 cells"),
    (WORDS[0].encode() + b"\na,b,c,d,e,f,g" * 7000, "Line 22 of the table has 'a' in the column 'theta_in"),
    ((b"a," * 60_000 + b"\n") * 3 + table(), "has no line that names its columns"),
    (
        b"theta_out / theta_in" + b",1" * 1700 + b"\n" + (b"1" + b",1" * 1700 + b"\n") * 10,
        "has 17000 rows of 3 cells; it may have at most 50000 cells",
    ),
    (zemax(b"1 " * 99, b"1 " * 99, b"1 " * 99, b"1 2 3 4"), "970299 rows of 7 cells; it may have at most 50000"),
    (b"", "The table is empty and has no line that names its columns; it needs one such as theta_in, "),
    ("\n".join(WORDS[1:]).encode(), "7 numbers, such as " + WORDS[1].replace(",", ", ")[:60] + ": name them by"),
    ("\n".join(["felt BRDF today", *WORDS[1:]]).encode(), "names its columns; its rows have 7 numbers"),
    (b"AOI=30\n;0;90;180\n" + b"10;0.1;0.2;0.3\n" * 60, "looks like a matrix, but its first cell is empty: write"),
    (
        b"# theta_i: 10\n" + b"".join(b"%d %d 0.5\n" % (theta, phi) for theta in (10, 30) for phi in range(0, 360, 6)),
        "such as 10, 0, 0.5: name them by their positions, as in --columns theta_out=1,phi_out=2,value=3.",
    ),
    (
        table(("alpha", "beta", "gamma", "delta", *CHANNELS)),
        "lacks theta_in and theta_out: not understood are its columns 'alpha', 'beta', 'gamma', 'delta'; understood "
        "are 'red', 'green', 'blue'; say which column is which, as in --columns theta_in=NAME, or give an angle that",
    ),
    (NO_Z, "The table lacks omega_out_z: not understood are its columns 'z'; understood are 'omega_in_x'"),
    (table((*DIRECTION, "red", "green", "violet")), "lacks blue: not understood are its columns 'violet'; understood"),
    (
        renamed("theta_in", "theta_i", "theta_out", "phi_out"),
        "'theta_in' and 'theta_i' both seem to be theta_in: leave one of them out, or choose, as in",
    ),
    (renamed("theta_in", "phi_in", "theta_out", "theta_in"), "or choose, as in --columns theta_in=1."),
    (table(columns=np.hstack([np.radians(ANGLES), RGB])), "is 1.48, as of angles in radians: write degrees, or name"),
    (
        table(ALL, np.hstack([np.rint(ANGLES) * [1.0, np.pi / 180.0, 1.0, np.pi / 180.0], RGB])),
        "The largest phi_in and phi_out is 6.28, as of angles in radians: write degrees, or name the columns phi_in_",
    ),
    (renamed(*(f"{name} [mil]" for name in DIRECTION)), "'theta_in [mil]' is in 'mil'; angles are in deg, rad or gon."),
    (table((*VECTORS, *CHANNELS), np.hstack([-spherical(ANGLES)[0], spherical(ANGLES)[1], RGB])), "whose normal is z"),
    (table((*DIRECTION, "L", "a", "b")), "understood are its columns 'L', 'a'; understood are 'theta_in', 'phi_in', "),
    (table((*DIRECTION, "optical density"), np.hstack([ANGLES, GREY[:, :1]])), "or 10^-v for densities."),
    (
        table(("AOI", "aspecular angle", "BRDF"), np.hstack([IN_PLANE[:, ::2], GREY[:, :1]])),
        "which is theta_in minus it",
    ),
    (
        table((*DIRECTION, "signal [V]"), np.hstack([ANGLES, GREY[:, :1]])),
        "and add --cosine out for a radiant intensity",
    ),
    (
        table(columns=np.hstack([ANGLES * [1, 1, 3, 1], RGB])),
        "'theta_out' has an angle of 253.843 degrees; 180 is the largest",
    ),
    (
        table((*DIRECTION, "R [%]"), np.hstack([ANGLES, RGB[:, :1]])),
        "'R [%]' is in '%'; the values of a BRDF are in 1/sr. If a factor makes them a BRDF, set",
    ),
    (table(number=lambda x: f"{x:.9g}".replace(".", ",")), "Line 2 of the table has 14 cells, separated by commas"),
    ("\n".join([*WORDS[:4], "1,2,3"]).encode(), "Line 5 of the table has 3 cells, and the line of names has 7."),
    (changed(4, "dark"), "Line 6 of the table has 'dark' in the column 'red'; write a number, or nan where"),
    (changed(4, "2026-05-01 00:00:00"), "it is a date or a time: write the number, and give its cell the format"),
    (changed(4, "4:40:44.9"), "it is a date or a time: write the number"),
    (changed(0, "1_0"), "Line 6 of the table has '1_0' in the column 'theta_in'"),
    (table((*VECTORS, *CHANNELS), OFF_UNIT), "In 240 of 240 rows omega_in is no unit vector; one has the length 1.05"),
    (changed(5, "-1"), "1 value is negative, down to -1, more than noise about zero explains: if they stand for"),
    (changed(5, "1e9"), "In 1 of 240 samples, the first of them number 5, values is above 1e8/sr"),
    (table(columns=np.hstack([ANGLES, 0.0 * RGB])), "Every sample is zero in all channels; a measurement has positive"),
    (zemax(b"0 9", b"0", b"0 9", b"1 2 3"), "The Zemax BSDF file has 3 values, and its angles need 4."),
    (
        b"SampleRotation 1\n0\nAngleOfIncidence 2\n0 30\nScatterRadial 2\n0 9\nDataBegin\n1 2 3 4\n",
        "The BSDF file has no line ScatterAzimuth with a count, and the angles below it.",
    ),
    (b"SpectralContent XYZ\nScatterRadial 2\n0 9\nDataBegin\n1 2 3 4\n", "XYZ; only Monochrome is read"),
    (b"TIS 1\nScatterRadial\n# DataBegin\n", "begins with 'TIS 1' and has no line that names its columns"),
    (changed(5, "1e30"), "no reflectance is; if 1e+30 stands for a missing value, set missing to it."),
    (changed(4, '"1'), "A quotation mark in the table is not closed on its line."),
]


@pytest.mark.parametrize(("content", "words"), WRONG, ids=[words for _, words in WRONG])
def test_what_is_no_table_is_told_the_remedy(content: bytes, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "MAX_CELLS", 50_000)  # A hundredth of the usual number is as good.
    with pytest.raises(MeasurementFormatError) as caught:
        parse_samples(content)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("cell", ["(" + " " * 100_000, "(" * 100_000, "a [" * 30_000, "- " * 50_000])
def test_a_long_cell_is_no_name_at_once(cell: str) -> None:
    assert meaning_of(cell) is None
    with pytest.raises(MeasurementFormatError):
        parse_samples(cell.encode() + b"\n1\n")


NAMES = [line.split(": ", 1) for line in (Path(__file__).parent / "column_names.txt").read_text().splitlines()]


@pytest.mark.parametrize(("meaning", "names"), NAMES, ids=[meaning for meaning, _ in NAMES])
def test_columns_are_understood_by_the_names_that_people_give(meaning: str, names: str) -> None:
    assert {name: meaning_of(name) or "nothing" for name in names.split(" | ")} == dict.fromkeys(
        names.split(" | "), meaning
    )
