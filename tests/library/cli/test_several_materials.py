"""Commands of several materials: a map, tables, reports in a row, a comparison."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import dsbrdf
from dsbrdf import decompose, render_sphere
from dsbrdf.rendering import sphere_likeness
from tests.support.command_line import document, printed, run
from tests.support.models import random_model


@pytest.mark.slow
def test_map_of_a_folder_and_what_it_refuses(tmp_path: Path) -> None:
    for seed in range(3):
        dsbrdf.save(random_model(seed), tmp_path / f"paint{seed}.json")
    answer = document("map", tmp_path, "-o", tmp_path / "map.png", "--json")
    expected = dsbrdf.space({f"paint{seed}": random_model(seed) for seed in range(3)})
    assert [item["name"] for item in answer["items"]] == list(expected.names)
    assert answer["items"][0]["nearest"] == [{"name": n, "db": db} for n, db in expected.nearest("paint0")]
    np.testing.assert_allclose([item["place"] for item in answer["items"]], expected.places)
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.size[0] > 1000


def test_several_reports_are_those_of_each(model_file: Path, tmp_path: Path) -> None:
    dsbrdf.save(random_model(1), other := tmp_path / "other.json")
    answer = document("show", model_file, other, "--json")["items"]
    assert [item["file"] for item in answer] == [str(model_file), str(other)]
    assert printed("show", model_file, other) == printed("show", model_file) + printed("show", other)


def test_compare_puts_components_side_by_side(tmp_path: Path) -> None:
    models = {name: random_model(seed) for seed, name in enumerate(("gloss", "satin", "matte"))}
    files = [tmp_path / f"{name}.json" for name in models]
    for file, model in zip(files, models.values(), strict=True):
        dsbrdf.save(model, file)
    run("compare", *files[:2], "-o", tmp_path / "both.png", "--size", "24")
    first, second = (decompose(model) for model in (models["gloss"], models["satin"]))
    rows_of_spheres = 1 + sum(len(whole) > 0 for whole in (first, second))
    with Image.open(tmp_path / "both.png") as picture:
        assert picture.size == (72, 24 * rows_of_spheres)
    about = document("compare", *files, "--size", "24", "--json")
    assert about["output"] is None
    alone = document("compare", files[0], files[2], "--size", "24", "--json")["likeness"]
    assert about["likeness"][1] == alone
    lobe = document("compare", *files[:2], "--size", "24", "--component", "specular_lobe", "--json")
    spheres = [render_sphere(whole["specular_lobe"], size=24) for whole in (first, second)]
    assert lobe["likeness"]["psnr"] == pytest.approx(sphere_likeness(*spheres)[0])
