"""Commands of several materials: a map, tables, reports in a row, a comparison."""

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import dsbrdf
from dsbrdf import decompose, render_sphere
from dsbrdf.rendering import sphere_likeness
from tests.support.command_line import document, load_fit, printed, run, sentence
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
    text = printed("map", *sorted(tmp_path.glob("*.json")), "-o", tmp_path / "map.pdf")
    assert f"{expected.nearest('paint1')[0][0]} ({expected.nearest('paint1')[0][1]:.1f} dB)" in text.splitlines()[2]
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.size[0] > 1000
    assert "at least two" in sentence("map", tmp_path / "paint0.json", "-o", tmp_path / "map.png")
    assert "must end in" in sentence("map", tmp_path, "-o", tmp_path / "map.gif")
    (tmp_path / "more").mkdir()
    dsbrdf.save(random_model(0), tmp_path / "more" / "paint0.json")
    assert "called paint0" in sentence("map", tmp_path, tmp_path / "more", "-o", tmp_path / "map.png")


def test_several_models_at_once_and_their_components_as_tables(model_file: Path, tmp_path: Path) -> None:
    other = tmp_path / "50%_gloss.json"
    dsbrdf.save(random_model(1), other)
    table, latex = tmp_path / "all.csv", tmp_path / "all.tex"
    text = printed("decompose", model_file, other, "--csv", table, "--latex", latex)
    assert f"{model_file.stem}:" in text.splitlines()
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert {row["material"] for row in rows} == {model_file.stem, "50%_gloss"}
    parts = decompose(random_model(1))
    assert {row["component"] for row in rows if row["material"] == "50%_gloss"} == {*parts.labels}
    psnr = load_fit(model_file).report.metrics.psnr
    assert {row["psnr"] for row in rows} == {str(psnr), ""}
    lines = latex.read_text().splitlines()
    body = [line for line in lines[4:-2] if line != r"\addlinespace"]
    assert len(body) == len(rows)
    assert {line.count("&") for line in body} == {9}
    count = sum(row["material"] == "50%_gloss" for row in rows)
    assert sum(rf"\multirow{{{count}}}{{*}}{{50\%\_gloss}} & " in line for line in body) == 1
    answer = document("show", model_file, other, "--json")["items"]
    assert [item["file"] for item in answer] == [str(model_file), str(other)]
    assert printed("show", model_file, other).startswith(printed("show", model_file))
    alone = tmp_path / "alone.csv"
    run("export", model_file, "--format", "components", "-o", alone)
    assert next(csv.DictReader(alone.read_text().splitlines()))["material"] == "alone"


def test_compare_names_models_and_puts_their_components_side_by_side(tmp_path: Path) -> None:
    models = {name: random_model(seed) for seed, name in enumerate(("gloss", "satin", "matte"))}
    files = [tmp_path / f"{name}.json" for name in models]
    for file, model in zip(files, models.values(), strict=True):
        dsbrdf.save(model, file)
    words = ["-o", tmp_path / "both.png", "--size", "24"]
    rows = {line.split("  ")[0]: line.split() for line in printed("compare", *files[:2], *words).splitlines()}
    first, second = (decompose(model) for model in (models["gloss"], models["satin"]))
    for part in first:
        row = rows[f"{part.label.replace('_', ' ')}: light"]
        expected = [f"{whole[part.label].light_share:.4g}" for whole in (first, second) if part.label in whole.labels]
        assert row[-len(expected) :] == expected
    rows_of_spheres = 1 + sum(len(whole) > 0 for whole in (first, second))
    with Image.open(tmp_path / "both.png") as picture:
        assert picture.size == (72, 24 * rows_of_spheres)
    text = printed("compare", *files, *words)
    assert "gloss, satin, matte, satin: difference x 4, matte: difference x 4, gloss: " in text
    about = document("compare", *files, "--size", "24", "--json")
    assert about["output"] is None
    alone = document("compare", files[0], files[2], "--size", "24", "--json")["likeness"]
    assert about["likeness"][1] == alone
    lobe = document("compare", *files[:2], "--size", "24", "--component", "specular_lobe", "--json")
    spheres = [render_sphere(whole["specular_lobe"], size=24) for whole in (first, second)]
    assert lobe["likeness"]["psnr"] == pytest.approx(sphere_likeness(*spheres)[0])
