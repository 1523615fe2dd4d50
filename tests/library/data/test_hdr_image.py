import importlib
import importlib.util
import struct
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.hdr_image import read_hdr_image
from dsbrdf.errors import ImageFormatError
from tests.support.mitsuba_variants import mitsuba_variant

# Wide enough for runs of 128 values that differ, the longest that there are.
IMAGE = (
    np.random.default_rng(0).uniform(0.5, 1.0, (6, 200, 3)).astype(np.float32) * np.logspace(-3, 3, 6)[:, None, None]
)
HEAD = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


@pytest.fixture(scope="module")
def mitsuba() -> ModuleType:
    if importlib.util.find_spec("OpenEXR") is None:
        pytest.skip('"OpenEXR" is not installed')
    return mitsuba_variant("scalar_rgb")


def written(mitsuba: ModuleType, image: NDArray[np.floating[Any]], path: Path) -> Path:
    mitsuba.Bitmap(image.astype(np.float32)).write(str(path))
    return path


def test_pictures_by_another_program_are_read(mitsuba: ModuleType, tmp_path: Path) -> None:
    exact = read_hdr_image(written(mitsuba, IMAGE, tmp_path / "a.exr"))
    np.testing.assert_array_equal(exact, IMAGE.astype(np.float32))
    coarse = read_hdr_image(written(mitsuba, IMAGE, tmp_path / "a.hdr"))
    np.testing.assert_allclose(coarse, IMAGE, rtol=0.01)  # eight bits and a common exponent


def test_rows_are_flat_or_in_runs(tmp_path: Path) -> None:
    path, flat = tmp_path / "a.hdr", bytes([128, 64, 0, 129]) * 16
    runs = bytes([2, 2, 0, 8, 136, 128, 2, 64, 64, 134, 64, 132, 0, 4, 0, 0, 0, 0, 136, 129]) * 2
    for rows, head, factor in ((flat, HEAD, 1.0), (runs, HEAD, 1.0), (flat, HEAD[:-1] + b"EXPOSURE=2\n\n", 0.5)):
        path.write_bytes(head + b"-Y 2 +X 8\n" + rows)
        expected = np.broadcast_to(factor * np.array([128.5, 64.5, 0.5]) / 128.0, (2, 8, 3))
        np.testing.assert_allclose(read_hdr_image(path), expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x89PNG\r\n\x1a\n", "The file is a PNG image; a picture of radiance is"),
        (b"hello", "neither a Radiance nor an OpenEXR picture"),
        (b"", "neither a Radiance nor an OpenEXR picture"),
        (HEAD + b"+X 8 -Y 2\n", "no line '-Y height +X width'"),
        (HEAD + b"-Y 0 +X 8\n", "it must have some"),
        (HEAD + b"-Y 99999 +X 99999\n", "99999 x 99999 pixels"),
        (HEAD + b"-Y 2 +X 8\n" + bytes(63), "rows are incomplete"),
        (HEAD + b"-Y 2 +X 8\n" + bytes([2, 2, 0, 8, 136, 1, 137, 1]), "rows are incomplete"),
        (HEAD + b"-Y 2 +X 8\n" + bytes([2, 2, 0, 8, 0]), "rows are incomplete"),
        (HEAD.replace(b"rgbe", b"xyze") + b"-Y 2 +X 8\n" + bytes(64), "not in RGB"),
    ],
)
def test_what_is_no_picture_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "a.hdr"
    path.write_bytes(content)
    with pytest.raises(ImageFormatError, match=words.replace("+", r"\+")):
        read_hdr_image(path)


def test_a_damaged_or_endless_exr_is_refused_and_values_below_zero_are_none(
    mitsuba: ModuleType, tmp_path: Path
) -> None:
    whole = written(mitsuba, IMAGE, tmp_path / "a.exr").read_bytes()
    (tmp_path / "b.exr").write_bytes(whole[:-40])
    (tmp_path / "c.exr").write_bytes(whole[:4] + struct.pack("<I", 2) + bytes(100))
    for name in ("b.exr", "c.exr"):
        with pytest.raises(ImageFormatError, match="damaged or cut off"):
            read_hdr_image(tmp_path / name)
    with pytest.raises(ImageFormatError, match="NaN or infinite"):
        read_hdr_image(written(mitsuba, np.where(IMAGE > 500, np.inf, IMAGE), tmp_path / "d.exr"))
    assert not read_hdr_image(written(mitsuba, -IMAGE, tmp_path / "e.exr")).any()


def test_the_name_must_tell_the_kind(tmp_path: Path) -> None:
    with pytest.raises(ImageFormatError, match=r"ends in .hdr or .exr, unlike 'a.png'"):
        read_hdr_image(tmp_path / "a.png")
