"""One table with the names and spellings of many people."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from dsbrdf import ScatteredSamples, read_measurement
from dsbrdf.arrays import Array
from dsbrdf.data import CHANNELS, half_difference
from dsbrdf.samples.names import meaning_of
from dsbrdf.samples.reading import parse_samples

PLATE = np.loadtxt(Path(__file__).parent / "plate.csv", delimiter=",", skiprows=1)
COUNT = len(PLATE)
ANGLES = PLATE[:, :4]
"""theta_in, phi_in, theta_out, phi_out of the samples [degrees]."""
RGB = PLATE[:, 4:]
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


ORDER = [6, 0, 5, 2, 4, 1, 3]
ALL = (*DIRECTION, *CHANNELS)
SPELLINGS = {
    "commas": table(),
    "phi below zero": table(columns=np.hstack([ANGLES - [0.0, 360.0, 0.0, 360.0], RGB])),
    "another order": table([ALL[i] for i in ORDER], np.hstack([ANGLES, RGB])[:, ORDER]),
    "[gon]": table((*(f"{name} [gon]" for name in DIRECTION), *CHANNELS), np.hstack([ANGLES / 0.9, RGB])),
    "brdf_red [1/sr]": table((*DIRECTION, *(f"brdf_{name} [1/sr]" for name in CHANNELS))),
    "red [sr^-1]": table((*DIRECTION, *(f"{name} [sr^-1]" for name in CHANNELS))),
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


NAMES = [line.split(": ", 1) for line in (Path(__file__).parent / "column_names.txt").read_text().splitlines()]


@pytest.mark.parametrize(("meaning", "names"), NAMES, ids=[meaning for meaning, _ in NAMES])
def test_columns_are_understood_by_the_names_that_people_give(meaning: str, names: str) -> None:
    assert {name: meaning_of(name) or "nothing" for name in names.split(" | ")} == dict.fromkeys(
        names.split(" | "), meaning
    )
