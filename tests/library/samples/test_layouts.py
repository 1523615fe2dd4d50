"""Files as instruments write them, of a known truth: each is read right, or what it is is told."""

from pathlib import Path

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError, read_measurement, read_samples
from dsbrdf.arrays import Array

MIRROR_60 = 0.48
"""The truth at 60 degrees, in the mirror direction [1/sr]."""
LAYOUTS = Path(__file__).parent / "layouts"
REFUSED = {
    "astm_e1392.txt": "is of ASTM E1392, without the names of its columns: write a line with them above",
    "window_bsdf.txt": r"is a BSDF file of LBNL WINDOW \(Klems XML or tensor tree\); evaluate it at pairs",
}


def truth(omega_in: Array, omega_out: Array) -> Array:
    """Diffuse, with a highlight about the mirror direction."""
    half = omega_in + omega_out
    theta_half = np.arccos(np.clip(half[:, 2] / np.linalg.norm(half, axis=1), -1.0, 1.0))
    return np.asarray(0.08 + 0.4 * np.exp(-((theta_half / 0.25) ** 2)))[:, None] * np.ones(3)


@pytest.mark.parametrize("path", sorted(LAYOUTS.iterdir()), ids=lambda path: path.name)
def test_layouts_are_read_or_refused_by_name(path: Path) -> None:
    if path.name in REFUSED:
        with pytest.raises(MeasurementFormatError, match=REFUSED[path.name]):
            read_samples(path)
        return
    samples = read_samples(path)
    assert len(samples.values) >= 54
    assert np.ptp(samples.values) > 0.2
    expected = truth(samples.omega_in, samples.omega_out)
    np.testing.assert_allclose(samples.values, expected, rtol=1e-4, atol=1e-5)


def test_a_zemax_file_may_end_in_bsdf(tmp_path: Path) -> None:
    path = tmp_path / "tile.bsdf"
    path.write_bytes((LAYOUTS / "zemax.txt").read_bytes())
    np.testing.assert_array_equal(read_measurement(path).values, read_samples(LAYOUTS / "zemax.txt").values)
