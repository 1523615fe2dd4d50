"""Stored models: nothing is lost, and whatever comes, the readers answer with a model or with one sentence."""

import json
from dataclasses import replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf import (
    DSBRDF,
    Decomposition,
    FitReport,
    FitResult,
    InvalidArgumentError,
    ModelFormatError,
    decompose,
    load,
    save,
)
from dsbrdf.fitting import Metrics
from dsbrdf.output import fit_from_json, from_json, result_from_json, to_json
from dsbrdf.output.serialize import model_from_dict, model_to_dict, report_from_dict
from tests.support.models import ARRAYS, TEXTS, assert_same_bits, make_model, random_model, single_lobe
from tests.support.reproduced import assert_reproduced


@pytest.mark.parametrize("interpolation", ["spline", "linear"])
@pytest.mark.parametrize(("n_lobes", "n_knots"), [(0, 4), (1, 1), (3, 18), (8, 19)])
def test_round_trips_are_bit_for_bit(n_lobes: int, n_knots: int, interpolation: str, report: FitReport) -> None:
    model = make_model(n_lobes, n_knots, interpolation)
    for written in (model, replace(model, delta=-np.zeros_like(model.delta))):  # the sign of zero too
        for attached in (None, report):
            back = from_json(to_json(written, attached))
            assert_same_bits(back[0], written)
            assert back[1] == attached
    assert_same_bits(model_from_dict(model_to_dict(model)), model)
    assert report_from_dict(report.to_dict()) == report


def test_components_are_read_back_bit_for_bit(report: FitReport) -> None:
    model = random_model()
    found = decompose(model)
    text = to_json(model, report, found)
    read, attached = fit_from_json(text)
    assert read.labels == found.labels
    assert (read.ranges, read.descriptions, read.layers) == (found.ranges, found.descriptions, found.layers)
    assert read.diffuse_range == found.diffuse_range
    assert [one.model for one in read.structures] == [one.model for one in found.structures]
    np.testing.assert_array_equal(read.albedos, found.albedos)
    assert_same_bits(read.model, model)
    assert attached == report


def test_numbers_need_no_fraction() -> None:
    model = single_lobe(1.0, 2.0, 3.0)
    assert from_json(to_json(model).replace(".0", ""))[0] == model


@pytest.mark.parametrize("suffix", [".json", ".JSON"])
def test_save_and_load(model: DSBRDF, report: FitReport, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"nickel{suffix}"
    save(model, path)
    assert load(path) == model
    with pytest.raises(ModelFormatError, match="has no report of a fit"):
        result_from_json(path.read_text())
    dsbrdf.save(FitResult(model, report), path)  # replaces
    assert load(str(path)) == result_from_json(to_json(model, report)) == FitResult(model, report)
    assert list(tmp_path.iterdir()) == [path]


def test_failed_save_keeps_the_existing_file(model: DSBRDF, report: FitReport, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    save(model, path)
    bad = replace(report, metrics=Metrics(relative_rms=float("nan")))
    with pytest.raises(InvalidArgumentError, match="report must contain only plain, finite values"):
        save(FitResult(model, bad), path)
    assert load(path) == model
    assert list(tmp_path.iterdir()) == [path]


def test_unknown_suffix_is_refused(model: DSBRDF, tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"\.json, unlike 'model\.txt'; dsbrdf\.export writes other kinds"):
        save(model, tmp_path / "model.txt")
    with pytest.raises(InvalidArgumentError, match=r"a Decomposition cannot be saved"):
        save(dsbrdf.decompose(model), tmp_path / "model.json")  # type: ignore[arg-type]
    with pytest.raises(InvalidArgumentError, match=r"must end in \.json, unlike 'model'"):
        load(tmp_path / "model")
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "missing.json")


@pytest.fixture(scope="module")
def parts() -> Decomposition:
    return decompose(random_model())


DAMAGE: dict[str, tuple[Any, ...]] = {
    "format": ("other",),
    "version": (..., "1", True, 0, 1, 3),
    "model": (..., [1]),
    **{f"model {name}": (...,) for name in (*ARRAYS, *TEXTS)},
    "model extra": (1,),
    "model amplitude": (..., [[[1.0]]]),
    "model amplitude 0": ([1.0],),
    "model kappa 0 0 0": ("1.0", 10**400),
    "model gamma 0 4 2": (-1.0, np.nan),
    "model interpolation": (..., 3, "magic"),
    "report": (...,),
    "report extra": (1,),
    "report metrics": ([],),
    "report metrics male": (..., "0.1", True, 10**400),
    "report n_numbers": (True,),
    "report search": ({},),
    "report timings em": (None,),
    "report by_theta_diff 0 theta_diff": ([0.0], [0.0, 0.1, 0.2]),
    "report options method": ("magic",),
    "report options n_lobes": (99,),
    "components": (...,),
    "components 0 label": ("gloss",),
    "components 0 ranges": (...,),
    "components 0 ranges albedo": (None,),
    "components 0 layers 0": ({},),
    "structures 0 is_diffuse": ([],),
    "diffuse_range": (...,),
}
"""Wrong values at places of the document; an ellipsis stands for none."""
CHANGES = [(place, value) for place, values in DAMAGE.items() for value in values]


@pytest.mark.parametrize(("place", "value"), CHANGES)
def test_damage_is_named(parts: Decomposition, report: FitReport, place: str, value: Any) -> None:
    document = json.loads(to_json(parts.model, report, parts))
    *path, last = (int(key) if key.isdigit() else key for key in place.split())
    inner = reduce(getitem, path, document)
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    with pytest.raises(ModelFormatError) as caught:
        fit_from_json(json.dumps(document))
    assert_reproduced(f"damage/{place} = {repr(value)[:20]}", str(caught.value))


def test_text_that_is_not_a_model() -> None:
    refused = dict.fromkeys(("", "{", "\x80", "[" * 100_000, "1" * 5000), "not valid JSON")
    for text, said in (refused | dict.fromkeys(("[]", "null"), "not an object")).items():
        with pytest.raises(ModelFormatError, match=said):
            from_json(text)


def test_other_files_are_refused(model: DSBRDF, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_bytes(to_json(model).encode("utf-16"))
    with pytest.raises(ModelFormatError, match="not a JSON text in UTF-8"):
        load(path)
    with path.open("wb") as file:
        file.truncate(10 << 30)
    with pytest.raises(ModelFormatError, match="longer than the 67108864 bytes"):
        load(path)
