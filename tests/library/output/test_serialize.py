"""Stored models: nothing is lost, and whatever comes, the readers answer with a model or with one sentence."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf import DSBRDF, FitReport, FitResult, InvalidArgumentError, ModelFormatError, decompose, load, save
from dsbrdf.fitting import Metrics
from dsbrdf.output import fit_from_json, from_json, result_from_json, to_json
from dsbrdf.output.serialize import model_from_dict, model_to_dict, report_from_dict
from tests.support.models import ARRAYS, TEXTS, assert_same_bits, make_model, random_model, single_lobe


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


@pytest.mark.parametrize(
    "damage",
    [
        lambda fit: fit["components"].reverse(),
        lambda fit: fit["components"][0].pop("ranges"),
        lambda fit: fit["components"][0]["ranges"].update(albedo=None),
        lambda fit: fit["components"][0]["layers"].append({}),
        lambda fit: fit.pop("diffuse_range"),
        lambda fit: fit["structures"][0].update(is_diffuse=[]),
    ],
)
def test_damaged_components_are_refused(damage: Callable[[dict[str, Any]], object]) -> None:
    model = random_model()
    document = json.loads(to_json(model, None, decompose(model)))
    damage(document)
    with pytest.raises(ModelFormatError):
        fit_from_json(json.dumps(document))
    with pytest.raises(ModelFormatError, match="stored components"):
        fit_from_json(to_json(model))


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


Document = dict[str, Any]


def _set(*path: Any, value: Any = ...) -> Callable[[Document], None]:
    """A change of the value at a place; without one, the place goes."""

    def change(document: Document) -> None:
        place: Any = document
        for key in path[:-1]:
            place = place[key]
        if value is ...:
            del place[path[-1]]
        else:
            place[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("format", value="other"), "its format is not 'dsbrdf'"),
        (_set("version"), "no valid version"),
        *((_set("version", value=bad), "no valid version") for bad in ("1", True, 0)),
        *((_set("version", value=n), f"version {n}; this release reads version 2") for n in (1, 3)),
        (_set("model"), "lacks the key 'model'"),
        (_set("report"), "lacks the key 'report'"),
        (_set("model", value=[1]), "stored model must be a mapping"),
        *((_set("model", name), f"stored model lacks the key '{name}'") for name in (*ARRAYS, *TEXTS)),
        (_set("model", "extra", value=1), "stored model has the unknown key 'extra'"),
        (_set("model", "amplitude", value=[[[1.0]]]), "amplitude must have shape"),
        (_set("model", "amplitude", 0, value=[1.0]), "amplitude is not a regular array"),
        *((_set("model", "kappa", 0, 0, 0, value=bad), "kappa is not an array of real") for bad in ("1.0", 10**400)),
        (_set("model", "gamma", 0, 4, 2, value=-1.0), "every gamma must be positive"),
        (_set("model", "gamma", 0, 4, 2, value=np.nan), "contains NaN; every number must be finite"),
        (_set("model", "interpolation", value=3), "interpolation in the stored model is not a text"),
        (_set("model", "interpolation", value="magic"), "interpolation must be one of"),
        (_set("report", "metrics", value=[]), "stored report.metrics must be a mapping"),
        (_set("report", "metrics", "male"), "stored report.metrics lacks the key 'male'"),
        *((_set("report", "metrics", "male", value=bad), "male is of the wrong") for bad in ("0.1", True, 10**400)),
        (_set("report", "n_numbers", value=True), "stored report.n_numbers is of the wrong kind, bool"),
        (_set("report", "search", value={}), "stored report.search is of the wrong kind, dict"),
        (_set("report", "timings", "em", value=None), "stored report.timings.em is of the wrong kind, NoneType"),
        (_set("report", "by_theta_diff", 0, "theta_diff", value=[0.0]), "theta_diff has 1 values, not 2"),
        (_set("report", "by_theta_diff", 0, "theta_diff", value=[0.0, 0.1, 0.2]), "theta_diff has 3 values, not 2"),
        (_set("report", "options", "method", value="magic"), "options.method is of the wrong kind, str"),
        (_set("report", "options", "n_lobes", value=99), "options in the stored report are not valid: n_lobes"),
        (_set("report", "extra", value=1), "stored report has the unknown key 'extra'"),
    ],
)
def test_damage_is_named(model: DSBRDF, report: FitReport, change: Callable[[Document], None], message: str) -> None:
    document = json.loads(to_json(model, report))
    change(document)
    with pytest.raises(ModelFormatError, match=message):
        from_json(json.dumps(document))


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
