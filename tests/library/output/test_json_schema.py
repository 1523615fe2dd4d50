"""Stored models follow the published schema, and the schema refuses what the library refuses."""

import importlib
import json
from typing import Any

import pytest

from dsbrdf import DSBRDF
from dsbrdf.cli.main import main
from dsbrdf.fitting.report import FitReport
from dsbrdf.output.json_schema import stored_model_schema
from dsbrdf.output.serialize import to_json
from tests.support.mixtures import mixture
from tests.support.random_models import papers_model

Validator = importlib.import_module("jsonschema_rs").Draft202012Validator


def test_stored_models_follow_the_schema(model: DSBRDF, report: FitReport) -> None:
    validator = Validator(stored_model_schema())
    for stored in (to_json(model, report), to_json(model), to_json(mixture(3, 0)), to_json(papers_model())):
        validator.validate(json.loads(stored))


@pytest.mark.parametrize(
    "damage",
    [
        lambda document: document.pop("version"),
        lambda document: document.update(version=1),
        lambda document: document.update(shine=1),
        lambda document: document["model"].pop("kappa"),
        lambda document: document["model"].update(amplitude=[1.0]),
        lambda document: document["model"].update(lobe="gauss"),
        lambda document: document["report"].pop("options"),
        lambda document: document["report"]["metrics"].update(psnr="high"),
        lambda document: document["report"]["options"].update(method="magic"),
    ],
)
def test_damaged_documents_do_not(model: DSBRDF, report: FitReport, damage: Any) -> None:
    document = json.loads(to_json(model, report))
    damage(document)
    assert not Validator(stored_model_schema()).is_valid(document)


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == stored_model_schema()
