"""The example table of the documentation is fitted as the page says, and Mitsuba draws what comes of it."""

import shutil
from pathlib import Path

import numpy as np

from dsbrdf.cli.main import main
from tests.support.mitsuba_variants import mitsuba_variant

EXAMPLE = Path(__file__).parents[2] / "docs/_static"


def test_the_table_becomes_a_sphere_with_a_purple_highlight(tmp_path: Path) -> None:
    mitsuba = mitsuba_variant("llvm_ad_rgb")
    for name in ("satin-purple.csv", "sphere.xml"):
        shutil.copy(EXAMPLE / name, tmp_path)
    assert main(["convert", str(tmp_path / "satin-purple.csv"), str(tmp_path / "satin-purple.bsdf")]) == 0
    picture = np.array(mitsuba.render(mitsuba.load_file(str(tmp_path / "sphere.xml")), spp=16))
    pixels = picture[..., :3].reshape(-1, 3)
    red, green, blue = pixels[np.argmax(pixels[:, 0])]
    assert min(red, blue) > 1.1 * green  # the highlight is purple, the rest is not
    assert 0.1 < picture[128, 100, :3].mean() < 0.9
    assert np.isfinite(picture).all()
