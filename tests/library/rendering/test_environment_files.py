import struct
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf import ImageFormatError, read_environment
from tests.support.mitsuba_variants import mitsuba_variant

PANORAMA = np.random.default_rng(0).uniform(0.5, 1.0, (64, 128, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def mitsuba() -> ModuleType:
    pytest.importorskip("OpenEXR")
    return mitsuba_variant("scalar_rgb")


def written(mitsuba: ModuleType, image: NDArray[np.floating[Any]], path: Path) -> Path:
    mitsuba.Bitmap(image.astype(np.float32)).write(str(path))
    return path


@pytest.mark.parametrize("alpha", [False, True])
def test_panoramas_by_another_program_are_read(mitsuba: ModuleType, tmp_path: Path, alpha: bool) -> None:
    image = np.concatenate([PANORAMA, np.ones((64, 128, 1), np.float32)], axis=2) if alpha else PANORAMA
    np.testing.assert_array_equal(read_environment(written(mitsuba, image, tmp_path / "a.exr")).pixels, PANORAMA)


def test_negative_values_become_0(mitsuba: ModuleType, tmp_path: Path) -> None:
    image = PANORAMA * np.where(np.arange(128) % 2, 1.0, -1.0)[:, np.newaxis]
    np.testing.assert_array_equal(
        read_environment(written(mitsuba, image, tmp_path / "a.exr")).pixels, np.maximum(image, 0.0)
    )


def test_damaged_files_are_refused(mitsuba: ModuleType, tmp_path: Path) -> None:
    whole = written(mitsuba, PANORAMA, tmp_path / "a.exr").read_bytes()
    (tmp_path / "b.exr").write_bytes(whole[:-40])
    (tmp_path / "c.exr").write_bytes(whole[:4] + struct.pack("<I", 2) + bytes(100))
    for name in ("b.exr", "c.exr"):
        with pytest.raises(ImageFormatError, match="damaged or cut off"):
            read_environment(tmp_path / name)
    with pytest.raises(ImageFormatError, match="values from 0 to"):
        read_environment(written(mitsuba, np.where(PANORAMA > 0.9, np.inf, PANORAMA), tmp_path / "d.exr"))
    with pytest.raises(ImageFormatError, match="has the channels Y, not R, G and B"):
        read_environment(written(mitsuba, PANORAMA[..., :1], tmp_path / "e.exr"))


@pytest.mark.parametrize("content", [b"#?RADIANCE\n\n-Y 4 +X 8\n", b"\x89PNG\r\n\x1a\n", b""])
def test_other_pictures_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.hdr").write_bytes(content)
    with pytest.raises(ImageFormatError, match=r"must be an OpenEXR picture; save it as \.exr"):
        read_environment(tmp_path / "a.hdr")
