import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dsbrdf.errors import InvalidArgumentError, ModelFormatError
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.report import FitReport, FitResult
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.serialize import (
    decomposition_from_json,
    from_json,
    from_npz,
    load,
    load_result,
    model_from_dict,
    model_to_dict,
    report_from_dict,
    result_from_json,
    save,
    to_json,
    to_npz,
)
from tests.support.known_models import single_lobe
from tests.support.models import ARRAYS, TEXTS, assert_same_bits, make_model
from tests.support.random_models import random_model


@pytest.mark.parametrize("interpolation", ["spline", "linear"])
@pytest.mark.parametrize(("n_lobes", "n_knots"), [(0, 4), (1, 1), (3, 18), (8, 19)])
def test_round_trips_are_bit_for_bit(n_lobes: int, n_knots: int, interpolation: str, report: FitReport) -> None:
    model = make_model(n_lobes, n_knots, interpolation)
    for written in (model, replace(model, delta=-np.zeros_like(model.delta))):  # the sign of zero too
        for attached in (None, report):
            for back in (from_json(to_json(written, attached)), from_npz(to_npz(written, attached))):
                assert_same_bits(back[0], written)
                assert back[1] == attached
    assert_same_bits(model_from_dict(model_to_dict(model)), model)
    assert report_from_dict(report.to_dict()) == report


def test_components_are_read_back_bit_for_bit(report: FitReport) -> None:
    model = random_model()
    found = decompose(model)
    text = to_json(model, report, found)
    read = decomposition_from_json(text)
    assert read.labels == found.labels
    assert_same_bits(read.guide, found.guide)
    assert_same_bits(read.model, model)
    assert from_json(text)[1] == report


@pytest.mark.parametrize(
    "change", [{"labels": ["diffuse"]}, {"labels": ["gloss"]}, {"labels": None}, {"guide": []}, {"guide": None}]
)
def test_damaged_components_are_refused(change: dict[str, object]) -> None:
    model = random_model()
    document = json.loads(to_json(model, None, decompose(model)))
    document["components"] |= change
    with pytest.raises(ModelFormatError):
        decomposition_from_json(json.dumps(document))
    with pytest.raises(ModelFormatError, match="no components"):
        decomposition_from_json(to_json(model))


def test_encoding_is_deterministic(model: DSBRDF, report: FitReport) -> None:
    assert to_json(model, report) == to_json(make_model(), report)
    assert to_npz(model, report) == to_npz(make_model(), report)


def test_json_layout_is_fixed(model: DSBRDF, report: FitReport) -> None:
    document = json.loads(to_json(model, report))
    assert document["format"] == "dsbrdf"
    assert document["version"] == 2
    assert list(document["model"]) == [*ARRAYS, *TEXTS]
    assert document["model"]["amplitude"][2][4][1] == model.amplitude[2, 4, 1]
    assert document["report"]["metrics"]["relative_rms"] == 0.1 + 0.2
    assert json.loads(to_json(model))["report"] is None


def test_numbers_need_no_fraction() -> None:
    model = single_lobe(1.0, 2.0, 3.0)
    assert from_json(to_json(model).replace(".0", ""))[0] == model


@pytest.mark.parametrize("suffix", [".json", ".npz", ".JSON"])
def test_save_and_load(model: DSBRDF, report: FitReport, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"nickel{suffix}"
    save(model, path)
    assert_same_bits(load(path), model)
    with pytest.raises(ModelFormatError, match="has no report of a fit"):
        load_result(path)
    save(FitResult(model, report), path)  # replaces
    assert_same_bits(load(str(path)), model)
    assert load_result(path) == result_from_json(to_json(model, report)) == FitResult(model, report)
    assert list(tmp_path.iterdir()) == [path]


def test_failed_save_keeps_the_existing_file(model: DSBRDF, report: FitReport, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    save(model, path)
    bad = replace(report, metrics=Metrics(relative_rms=float("nan")))
    for target in (path, tmp_path / "model.npz"):
        with pytest.raises(InvalidArgumentError, match="report must contain only plain, finite values"):
            save(FitResult(model, bad), target)
    assert_same_bits(load(path), model)
    assert list(tmp_path.iterdir()) == [path]


def test_unknown_suffix_is_refused(model: DSBRDF, tmp_path: Path) -> None:
    with pytest.raises(
        InvalidArgumentError, match=r"\.json or \.npz, unlike 'model\.txt'; dsbrdf\.export writes other kinds"
    ):
        save(model, tmp_path / "model.txt")
    with pytest.raises(InvalidArgumentError, match=r"must end in \.json or \.npz, unlike 'model'"):
        load(tmp_path / "model")
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "missing.json")
