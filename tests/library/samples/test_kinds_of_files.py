"""Files of other kinds: named alike by every reader, with what to do; layouts of tables: listed once."""

from pathlib import Path

import pytest

from dsbrdf import MeasurementFormatError, read_measurement, read_samples
from dsbrdf.samples.layouts import LAYOUTS
from dsbrdf.samples.reading import read_table

KINDS = {
    "a Fourier BSDF (SCATFUN), the coefficients of a model; evaluate it": b"SCATFUN\x01" + bytes(56),
    "a binary file of ALTA; write it as a text": b"#DIM 3 1\n#PARAM_IN CARTESIAN\n#FORMAT binary\n" + bytes(99),
    "a Git LFS pointer in place of the file; fetch": b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
    "a dBase table (DBF); open it in a spreadsheet": b"\x03\x7a\x05\x11\x60\0\0\0\xa1\0\x29\0" + bytes(150),
    "an OpenEXR image; a picture has no directions": b"v/1\x01\x02\0\0\0channels\0chlist\0",
    "packed by gzip; unpack it first": b"\x1f\x8b\x08\0" + bytes(40),
    "a NumPy array (.npy); write its samples as a table": b"\x93NUMPY\x01\0v\0{'descr': '<f8'}\n" + bytes(800),
    "a web page; download the file itself": b"\n<!DOCTYPE html>\n<html><body>Sign in</body></html>",
    "an HDF5 file, perhaps of MATLAB or netCDF; write": b"\x89HDF\r\n\x1a\n" + bytes(80),
    "of an unknown kind: neither a MERL file": b"\x7fELF\x02\x01\x01" + bytes(80),
}


@pytest.mark.parametrize("words", KINDS)
def test_every_reader_names_another_kind_of_file_alike(words: str, tmp_path: Path) -> None:
    path = tmp_path / "paint.bsdf"
    path.write_bytes(KINDS[words])
    sentences = set()
    for read in (read_measurement, read_samples, lambda file: read_table(file.read_bytes())):
        with pytest.raises(MeasurementFormatError) as caught:
            read(path)
        sentences.add(str(caught.value))
    (sentence,) = sentences
    assert sentence.startswith(f"The file is {words}")


def test_the_page_on_formats_lists_every_layout_with_its_example() -> None:
    page = (Path(__file__).parents[3] / "docs/formats.md").read_text()
    rows = [f"| {layout.name} | `{layout.example}` |" for layout in LAYOUTS]
    assert "\n".join(rows) in page
