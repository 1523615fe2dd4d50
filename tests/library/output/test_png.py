"""PNG files, read back by Pillow."""

import io

import numpy as np
import pytest
from PIL import Image

from dsbrdf.output.sphere_panels import encode_png


@pytest.mark.parametrize("channels", [3, 4])
def test_pillow_reads_the_pixels(channels: int) -> None:
    levels = np.random.default_rng(0).integers(0, 256, (5, 7, channels), dtype=np.uint8)
    with Image.open(io.BytesIO(encode_png(levels / 255.0))) as image:
        assert image.mode == {3: "RGB", 4: "RGBA"}[channels]
        assert np.array_equal(np.asarray(image), levels)


def test_values_are_clipped() -> None:
    with Image.open(io.BytesIO(encode_png(np.array([[[-1.0, 0.5, 7.0]]])))) as image:
        assert image.getpixel((0, 0)) == (0, 128, 255)
