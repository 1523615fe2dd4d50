"""Files that are no tables of samples: each is refused with one sentence, which names what is wrong and what helps."""

from pathlib import Path

import pytest

from dsbrdf import MeasurementFormatError, read_samples
from dsbrdf.samples import cells
from dsbrdf.samples.names import meaning_of
from dsbrdf.samples.reading import parse_samples
from tests.library.samples.test_reading import table
from tests.support.reproduced import assert_reproduced

FOLDER = Path(__file__).parent / "refused"


@pytest.mark.parametrize("path", sorted(FOLDER.iterdir()), ids=lambda path: path.name)
def test_what_is_no_table_is_told_the_remedy(path: Path) -> None:
    with pytest.raises(MeasurementFormatError) as caught:
        read_samples(path)
    assert "\n" not in str(caught.value)
    assert_reproduced(f"refused/{path.name}", str(caught.value))


HEAD = table().splitlines()[0]
TOO_LARGE = {
    "Line 242 of the table has 140000 characters; it may have at most 131072.": table() + b"1;" * 70_000,
    "Line 242 of the table has 65001 cells, and the line of names has 7": table() + b"1," * 65_000,
    "The table has 4097 columns; it may have at most 4096.": b"theta_in," * 4097 + b"\n1",
    "has 7150 rows of 7 cells; it may have at most 50000 cells": HEAD + b"\n,,,,,,\n" * 7150,
    "Line 22 of the table has 'a' in the column 'theta_in": HEAD + b"\na,b,c,d,e,f,g" * 7000,
    "has no line that names its columns": (b"a," * 60_000 + b"\n") * 3 + table(),
    "has 17000 rows of 3 cells; it may have at most 50000 cells": (
        b"theta_out / theta_in" + b",1" * 1700 + b"\n" + (b"1" + b",1" * 1700 + b"\n") * 10
    ),
    "970299 rows of 7 cells; it may have at most 50000": b"SampleRotation 1\n0\n%bDataBegin\n1 2 3 4\n"
    % b"".join(
        b"%b 99\n%b\n" % (name, b"1 " * 99) for name in (b"AngleOfIncidence", b"ScatterAzimuth", b"ScatterRadial")
    ),
}


@pytest.mark.parametrize("words", TOO_LARGE)
def test_what_is_too_large_is_told_at_once(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "MAX_CELLS", 50_000)  # A hundredth of the usual number is as good.
    with pytest.raises(MeasurementFormatError) as caught:
        parse_samples(TOO_LARGE[words])
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("cell", ["(" + " " * 100_000, "(" * 100_000, "a [" * 30_000, "- " * 50_000])
def test_a_long_cell_is_no_name_at_once(cell: str) -> None:
    assert meaning_of(cell) is None
    with pytest.raises(MeasurementFormatError):
        parse_samples(cell.encode() + b"\n1\n")
