"""Exports hold the fitted model without loss."""

import json
import re
from dataclasses import asdict
from functools import cache
from typing import Any

import pytest

import dsbrdf
from dsbrdf.data import FILE_SIZE
from dsbrdf.output import FORMATS, export_model, from_json
from dsbrdf.output.export import part_of
from tests.support.models import assert_same_bits
from tests.support.server import Server, assert_problem

pytestmark = pytest.mark.slow


def test_exports_are_lossless(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    url = f"/v1/fits/{fitted}/export"
    text = server.http.get(url, params={"format": "json"})
    assert json.loads(text.text)["format"] == "dsbrdf"
    again, report = from_json(text.text)
    named = server.http.get(f"/v1/fits/{fitted}").json()["name"]  # Another test may have named it.
    assert named or f"{fitted}.json" in text.headers["content-disposition"]
    assert_same_bits(again, model)
    assert report is not None
    assert asdict(report.metrics) == server.http.get(f"/v1/fits/{fitted}").json()["metrics"]


@cache
def part(model: dsbrdf.DSBRDF, component: str | None) -> Any:
    """What is exported of a model, decomposed once."""
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


def test_a_part_of_an_export_is_answered_with_all_of_it(server: Server, fitted: str) -> None:
    url = f"/v1/fits/{fitted}/export?format=merl"
    whole = server.http.get(url, headers={"Range": "bytes=0-11"})
    assert (whole.status_code, len(whole.content)) == (200, FILE_SIZE)


def test_example_shows_the_export_that_it_is_saved_beside(server: Server, fitted: str) -> None:
    url = f"/v1/fits/{fitted}/export"
    scene = server.http.get(url, params={"format": "bsdf", "example": True})
    (name,) = re.findall('filename="(.*)\\.xml"', scene.headers["content-disposition"])
    assert f'<string name="filename" value="{name}.bsdf"/>' in scene.text
    page = server.http.get(url, params={"format": "glsl", "example": True}).text
    assert server.http.get(url, params={"format": "glsl"}).text in page
    answer = server.http.get(url, params={"format": "csv", "example": True})
    assert "not for csv" in assert_problem(answer, 422, "invalid-argument")
