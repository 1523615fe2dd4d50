"""Results of fits: components, exports as the library makes them, and the materials that come with the service."""

import json
import re
from dataclasses import asdict
from functools import cache
from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf.output import FORMATS, export_model, fit_from_json, to_json
from dsbrdf.output.documents import component_documents
from dsbrdf.output.export import part_of
from dsbrdf_service.compute.computations import LoadedFit
from dsbrdf_service.errors import ProblemError
from tests.support.server import Guarded, Server, assert_problem

POINTS: dict[str, list[float]] = {"theta_half_deg": [0, 0.5, 5, 40, 80], "theta_diff_deg": [0, 80, 20, 60, 5]}


def test_components_of_the_library_lead_the_document(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    items = server.http.get(f"/v1/fits/{fitted}/components").json()["items"]
    fit = server.http.get(f"/v1/fits/{fitted}").json()
    assert fit["components"] == items == json.loads(json.dumps(component_documents(model)))
    assert list(fit).index("components") < list(fit).index("model")


def test_a_black_fit_has_no_components(model: dsbrdf.DSBRDF) -> None:
    black = dsbrdf.decompose(model.select((), with_delta=False))
    restored, _ = fit_from_json(to_json(black.model, None, black))
    with pytest.raises(ProblemError, match=r"^The fit has no component diffuse: it reflects no light\.$") as raised:
        LoadedFit(restored, None).part("diffuse")
    assert raised.value.kind == "not-found"


@cache
def part(model: dsbrdf.DSBRDF, component: str | None) -> Any:
    return part_of(model, component)


@pytest.mark.parametrize(
    ("file_format", "component", "named"),
    [
        ("merl", None, {}),
        ("csv", None, {}),
        ("json", "layers", {}),
        ("brdf", "layers", {}),
        ("glsl", "diffuse", {"name": "paint"}),
    ],
)
def test_formats_of_other_programs_are_those_of_the_library(
    server: Server, fitted: str, model: dsbrdf.DSBRDF, file_format: str, component: str | None, named: dict[str, Any]
) -> None:
    query = {"format": file_format, **named} | ({} if component is None else {"component": component})
    answer = server.http.get(f"/v1/fits/{fitted}/export", params=query)
    kind = FORMATS[file_format]
    assert answer.content == export_model(part(model, component), file_format, **named)
    assert answer.headers["content-type"] == kind.media_type
    assert f"{component or ''}.{kind.suffix}" in answer.headers["content-disposition"]


def test_example_shows_the_export_that_it_is_saved_beside(server: Server, fitted: str) -> None:
    url = f"/v1/fits/{fitted}/export"
    scene = server.http.get(url, params={"format": "bsdf", "example": True})
    (name,) = re.findall('filename="(.*)\\.xml"', scene.headers["content-disposition"])
    assert f'<string name="filename" value="{name}.bsdf"/>' in scene.text
    page = server.http.get(url, params={"format": "glsl", "example": True}).text
    assert server.http.get(url, params={"format": "glsl"}).text in page
    answer = server.http.get(url, params={"format": "csv", "example": True})
    assert "not for csv" in assert_problem(answer, 422, "invalid-argument")


def test_materials_are_fits_that_everyone_has_and_nobody_changes(guarded: Guarded) -> None:
    http = guarded.server.http
    items = http.get("/v1/materials", headers=guarded.alice).json()["items"]
    assert [item["name"] for item in items] == list(dsbrdf.materials())
    path = f"/v1/fits/{items[0]['id']}"
    assert_problem(http.get(path), 401, "unauthorized")
    for key in (guarded.alice, guarded.bob):
        document = http.get(path, headers=key).json()
        result = dsbrdf.load_material(document["name"])
        assert document["warnings"] == list(result.report.warnings)
        assert document["metrics"] == asdict(result.report.metrics)
        assert [part["label"] for part in document["components"]] == list(dsbrdf.decompose(result).labels)
        values = http.get(f"{path}/brdf?theta_half_deg=10&theta_diff_deg=30", headers=key).json()["values"]
        expected = result.model.evaluate(np.radians(10), np.radians(30))
        assert values[0] == pytest.approx(expected, rel=1e-12)
        assert http.get(f"{path}/export?format=glsl", headers=key).is_success
        assert items[0]["id"] not in http.get("/v1/fits", headers=key).text
        for answer in (http.patch(path, json={"name": "mine"}, headers=key), http.delete(path, headers=key)):
            detail = assert_problem(answer, 405, "method-not-allowed")
            assert detail == "The fit comes with the service; it cannot be renamed or deleted."
        assert http.get(path, headers=key).json() == document
