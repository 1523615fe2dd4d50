"""Texts as other programs write them: of one known truth, in their encodings and with their marks."""

import json

import numpy as np
import pytest

from dsbrdf.samples.reading import parse_samples
from tests.library.samples.test_reading import spherical
from tests.library.samples.test_tables_as_people_have_them import GRID, NAMES, TRUE

LINES = [",".join(map(repr, row)) for row in np.column_stack([GRID - [0.0, 180.0, 0.0, 180.0], TRUE]).tolist()]
TEXT = "\n".join([",".join(NAMES), *LINES])
GERMAN = "Einfallswinkel;Azimut Quelle;Ausfallswinkel;Azimut Detektor"
ENCODED = {
    "title of Windows": ("Tile 5 – “black”\n" + TEXT).encode("cp1252"),
    "title in Japanese": ("試料\n" + TEXT).encode("shift_jis"),
    "UTF-16 without a mark": TEXT.encode("utf-16-le"),
    "dashes and footnotes": TEXT.replace("-", "–").replace("\n", "*\n").replace("value*", "value").encode(),
    "names behind the rows": "\n".join([*LINES[:400], "# " + ",".join(NAMES)]).encode(),
    "numbers of rows, as R writes": "\n".join(
        [" ".join(NAMES), *(f'"{at}" {line.replace(",", " ")}' for at, line in enumerate(LINES, 1))]
    ).encode(),
    "a record on each line": "\n".join(
        json.dumps(dict(zip(NAMES, map(float, line.split(",")), strict=True))) for line in LINES
    ).encode(),
    "German": TEXT.replace(",", ";").replace(".", ",").replace(";".join(NAMES[:4]), GERMAN).encode(),
    "matrix from 0": TEXT.replace("value", "M00,M11").replace("\n", ",7\n").replace("M11,7", "M11").encode() + b",7",
}


@pytest.mark.parametrize("kind", ENCODED)
def test_texts_of_other_programs_are_read(kind: str) -> None:
    samples = parse_samples(ENCODED[kind])
    count = len(samples.values)
    assert count >= 400
    np.testing.assert_allclose(samples.values[:, 0], TRUE[:count], rtol=1e-12)
    np.testing.assert_allclose(samples.omega_out, spherical(GRID - [0, 0, 0, 180])[1][:count], atol=1e-9)


def test_radiance_factors_are_told_with_both_options() -> None:
    samples = parse_samples(TEXT.replace("value", "I/F").encode())
    assert "the BRDF: if they are, set scale to 0.3183, and cosine to in" in samples.notes[0]
