"""Layouts of instruments as files, and tables of a known truth: each is read right, or what is wrong is told."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dsbrdf.arrays import Array
from dsbrdf.data.measurement_files import read_measurement
from dsbrdf.data.sample_tables import is_table, parse_samples, read_samples
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.data.table_options import TableOptions
from dsbrdf.errors import MeasurementFormatError
from tests.library.data.test_sample_tables import table

MIRROR_60 = 0.48
"""The truth at 60 degrees, in the mirror direction [1/sr]."""
LAYOUTS = Path(__file__).parent / "layouts"
REFUSED = {
    "astm_e1392.txt": "is a file of ASTM E1392, which is not read",
    "window_bsdf.txt": "is HTML or XML",
    "bird.txt": "is JSON",
}


def truth(omega_in: Array, omega_out: Array) -> Array:
    """Diffuse, with a highlight about the mirror direction."""
    half = omega_in + omega_out
    theta_half = np.arccos(np.clip(half[:, 2] / np.linalg.norm(half, axis=1), -1.0, 1.0))
    return np.asarray(0.08 + 0.4 * np.exp(-((theta_half / 0.25) ** 2)))[:, None] * np.ones(3)


def check_true(samples: ScatteredSamples) -> None:
    expected = truth(samples.omega_in, samples.omega_out)
    np.testing.assert_allclose(samples.values, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("path", sorted(LAYOUTS.iterdir()), ids=lambda path: path.name)
def test_layouts_are_read_or_refused_by_name(path: Path) -> None:
    if path.name in REFUSED:
        with pytest.raises(MeasurementFormatError, match=REFUSED[path.name]):
            read_samples(path)
        return
    samples = read_samples(path)
    assert len(samples.values) >= 54
    assert np.ptp(samples.values) > 0.2
    check_true(samples)


def test_a_zemax_file_may_end_in_bsdf(tmp_path: Path) -> None:
    path = tmp_path / "tile.bsdf"
    path.write_bytes((LAYOUTS / "zemax.txt").read_bytes())
    assert is_table(path)
    np.testing.assert_array_equal(read_measurement(path).values, read_samples(LAYOUTS / "zemax.txt").values)


RANDOM = np.random.default_rng(7)
NAMES = ("theta_in", "phi_in", "theta_out", "phi_out", "value")
ANGLES = RANDOM.uniform((0.0, 0.0, 0.0, 0.0), (80.0, 360.0, 80.0, 360.0), (400, 4))
ANGLES[:200, 2] = np.clip(ANGLES[:200, 0] + RANDOM.normal(0.0, 8.0, 200), 0.0, 80.0)  # near the mirror direction
ANGLES[:200, 3] = ANGLES[:200, 1] + 180.0 + RANDOM.normal(0.0, 8.0, 200)
ANGLES[:, 3] %= 360.0
PLANE = np.column_stack([RANDOM.uniform(0.0, 75.0, 400), RANDOM.uniform(-80.0, 80.0, 400)])


def vectors(angles: Array) -> tuple[Array, Array]:
    theta, phi = np.radians(angles[:, ::2]), np.radians(angles[:, 1::2])
    both = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    return both[:, 0], both[:, 1]


VALUES = truth(*vectors(ANGLES))[:, :1]
COS_IN, COS_OUT = (np.cos(np.radians(ANGLES[:, [at]])) for at in (0, 2))
IN_PLANE = truth(*vectors(np.insert(PLANE, [1, 2], [180.0, 0.0], axis=1)))[:, :1]
SPOILED = np.arange(400)[:, None] % 13 == 0
FLAT = VALUES * np.ones(5)
SPECTRAL = (*NAMES[:4], *(f"{band} nm" for band in range(450, 651, 50)))
MIRRORED = np.add(ANGLES, [0.0, 180.0, 0.0, 0.0]) % 360.0


def made(*columns: Array, names: tuple[str, ...] = NAMES) -> bytes:
    return table(names, np.hstack([ANGLES, *columns]))


def in_plane(*columns: Array) -> bytes:
    return table(("AOI", "AOR", "value"), np.hstack(columns))


# table, options, what is told; right where nothing is
TRUTHS: dict[str, tuple[bytes, dict[str, Any], str]] = {
    "as it is": (made(VALUES), {}, ""),
    "phi below zero": (table(NAMES, np.hstack([ANGLES - [0.0, 360.0, 0.0, 360.0], VALUES])), {}, ""),
    "per cent": (made(100.0 * VALUES), {"scale": 0.01}, ""),
    "times the cosine of the light": (made(COS_IN * VALUES), {"cosine": "in"}, ""),
    "times the cosine of the viewer, per cent": (made(100.0 * COS_OUT * VALUES), {"cosine": "out", "scale": 0.01}, ""),
    "-999 and 1e30 are missing": (
        made(np.where(SPOILED, np.where(VALUES > 0.1, 1e30, -999.0), VALUES)),
        {"missing": (-999, 1e30)},
        "",
    ),
    "mirror at the same phi": (table(NAMES, np.hstack([MIRRORED, VALUES])), {"phi": "mirror"}, ""),
    "in plane": (in_plane(PLANE, IN_PLANE), {}, ""),
    "in plane, sign turned": (in_plane(PLANE * [1, -1], IN_PLANE), {"phi": "mirror"}, ""),
    "flat spectra": (made(FLAT, names=SPECTRAL), {}, ""),
    "-999 is missing, not said": (made(np.where(SPOILED, -999.0, VALUES)), {}, "set missing to -999."),
    "0 is missing in one of five bands, not said": (
        made(np.where(SPOILED * [0, 1, 0, 0, 0], 0.0, FLAT), names=SPECTRAL),
        {},
        "31 samples have the same smallest value, 0, far from all others",
    ),
    "1e30 is missing, not said": (made(np.where(SPOILED, 1e30, VALUES)), {}, "if 1e+30 stands for what is missing"),
    "no phi_in, not said": (
        table(NAMES[:1] + NAMES[2:], np.hstack([ANGLES[:, [0, 2, 3]], VALUES])),
        {},
        "has no phi_in",
    ),
    "unit of another kind": (made(VALUES, names=(*NAMES[:4], "BRDF [%]")), {}, "is in '%'"),
}


@pytest.mark.parametrize(("content", "choices", "words"), TRUTHS.values(), ids=TRUTHS.keys())
def test_a_table_of_a_known_truth_is_right_or_told(content: bytes, choices: dict[str, Any], words: str) -> None:
    try:
        samples = parse_samples(content, options=TableOptions(**choices))
        said: tuple[str, ...] = samples.notes
    except MeasurementFormatError as error:
        said = (str(error),)
    if words:
        assert any(words in sentence for sentence in said), said
    else:
        check_true(samples)
        assert not any("set " in sentence for sentence in said), said


def test_values_of_one_pair_of_directions_that_are_far_apart_are_told() -> None:
    rows = np.hstack([ANGLES, VALUES])
    again = rows[10:40] * [1.0, 1.0, 1.0, 1.0, 1.02]
    assert len(parse_samples(table(NAMES, np.vstack([rows, again]))).notes) == 1  # of one channel
    again[[3, 7], 4:] *= 1.5
    again[3] -= [0.0, 360.0, 0.0, 360.0, 0.0]
    note = parse_samples(table(NAMES, np.vstack([rows, again]))).notes[-1]
    assert note.startswith("2 pairs of directions have values that differ by more than 25%, such as theta_in = ")
