"""Tables of scattered samples, and tables that are none."""

from pathlib import Path

import numpy as np
import pytest

from dsbrdf.data.scattered_samples import DIRECTIONS, ScatteredSamples, parse_samples, read_samples
from dsbrdf.errors import MeasurementFormatError

HEAD = ",".join((*DIRECTIONS, "red", "green", "blue"))
ROW = "0.6,0,0.8,0,-0.28,0.96,0.5,0.25,0.125"
OTHER = "0,0,1,0,0,1,1,2,3"


def table(row: str = ROW, *, head: str = HEAD, count: int = 300) -> bytes:
    return "\n".join([head, *[OTHER] * (count - 1), row, ""]).encode()


def test_columns_may_have_any_order(tmp_path: Path) -> None:
    path = tmp_path / "felt.csv"
    path.write_bytes(table())
    samples = read_samples(path)
    assert samples.name == "felt"
    assert samples.values.shape == (300, 3)
    np.testing.assert_allclose(samples.omega_in[-1], [0.6, 0.0, 0.8])
    np.testing.assert_allclose(samples.omega_out[-1], [0.0, -0.28, 0.96])
    np.testing.assert_array_equal(samples.values[-1], [0.5, 0.25, 0.125])
    np.testing.assert_array_equal(samples.weight, 1.0)
    names = [*HEAD.split(","), " Weight"]
    lines = [",".join([*line.split(","), "2"][::-1]) for line in [OTHER] * 299 + [ROW]]
    turned = parse_samples("\r\n".join([",".join(names[::-1]), *lines]).encode())
    np.testing.assert_array_equal(turned.values, samples.values)
    np.testing.assert_array_equal(turned.omega_in, samples.omega_in)
    np.testing.assert_array_equal(turned.weight, 2.0)
    assert turned.sha256 != samples.sha256


def test_directions_are_made_unit_vectors() -> None:
    samples = parse_samples(table("0.6004,0,0.8,0,-0.28,0.96,0.5,0.25,0.125"))
    np.testing.assert_allclose(np.linalg.norm(samples.omega_in, axis=1), 1.0, rtol=1e-15)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "it lacks 'omega_in_x'"),
        (table(head=HEAD.replace("green", "grün")), "it lacks 'green'"),
        (table(head=HEAD + ",shine"), "unknown column 'shine'"),
        (table(head=HEAD + ",red"), "a column twice"),
        (table(ROW + ",1"), "A row of the table is not 9 numbers"),
        (table("a" + ROW), "A row of the table is not 9 numbers"),
        (table(head=HEAD + ",weight"), "The rows of the table have 9 numbers, not 10"),
        (HEAD.encode(), "There are 0 samples; a fit needs at least 200"),
        (table(count=1), "There is 1 sample; a fit needs at least 200"),
        (table(count=199), "There are 199 samples; a fit needs at least 200"),
        (table(ROW.replace("0.6", "0.7")), "the first of them number 300, omega_in is not of unit length"),
        (table(ROW.replace("0.96", "-0.96")), "omega_out is not above the horizon"),
        (table("1,0,0,0,0,1,1,1,1"), "omega_in is not above the horizon"),
        (table(ROW.replace("0.25", "-0.25")), "In 1 of 300 samples, .* values is negative"),
        (table(ROW.replace("0.25", "nan")), "values is NaN or infinite"),
        (table(ROW.replace("0.25", "1e9")), "values is above 1e8/sr"),
        (b"\xff\xfe,\n", "not a text in UTF-8"),
        (b"PK\x03\x04", "The data is a ZIP archive"),
        (table(ROW.replace("0.5,0.25,0.125", "0,0,0")).replace(b"1,2,3", b"0,0,0"), "Every sample is zero"),
    ],
)
def test_what_is_no_table_of_samples_is_refused(content: bytes, words: str) -> None:
    with pytest.raises(MeasurementFormatError, match=words) as caught:
        parse_samples(content)
    assert "\n" not in str(caught.value)


def test_weights_are_positive_and_as_many_as_samples() -> None:
    up = np.tile([0.0, 0.0, 1.0], (300, 1))
    with pytest.raises(MeasurementFormatError, match="weight is not positive; leave out"):
        ScatteredSamples.from_arrays(up, up, up, np.zeros(300))
    with pytest.raises(MeasurementFormatError, match=r"weight must have the shape \(300,\), not \(3,\)"):
        ScatteredSamples.from_arrays(up, up, up, np.ones(3))
    with pytest.raises(MeasurementFormatError, match="omega_in must be real numbers"):
        ScatteredSamples.from_arrays([["a"]], up, up)
