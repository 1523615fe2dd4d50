"""Exports hold the fitted model without loss."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import dsbrdf
from dsbrdf.data.grid import THETA_HALF
from dsbrdf.data.merl import encode_merl, parse_merl
from dsbrdf.output.export import FORMATS, export_model, part_of
from dsbrdf.output.export.merl import merl_parts
from dsbrdf.output.serialize import from_json
from tests.support.models import assert_same_bits
from tests.support.server import Server

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]


def test_exports_are_lossless(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    url = f"/v1/fits/{fitted}/export"
    text = server.http.get(url, params={"format": "json"})
    assert json.loads(text.text)["format"] == "dsbrdf"
    again, report = from_json(text.text)
    named = server.http.get(f"/v1/fits/{fitted}").json()["name"]  # by another test, perhaps
    assert named or f"{fitted}.json" in text.headers["content-disposition"]
    assert_same_bits(again, model)
    assert report is not None
    assert asdict(report.metrics) == server.http.get(f"/v1/fits/{fitted}").json()["metrics"]

    table = parse_merl(server.http.get(url, params={"format": "merl"}).content)
    np.testing.assert_allclose(table.values[:, 10, 20, 30], model.evaluate(*np.radians([10 / 9, 20, 30])))


@pytest.mark.parametrize(
    ("file_format", "component", "named"),
    [
        *((name, "diffuse", {}) for name in ("brdf", "bsdf", "merl")),
        ("csv", None, {}),
        ("csv", "guide", {}),
        ("glsl", "diffuse", {"name": "paint", "sampling": True}),
    ],
)
def test_formats_of_other_programs_are_those_of_the_library(
    server: Server, fitted: str, model: dsbrdf.DSBRDF, file_format: str, component: str | None, named: dict[str, Any]
) -> None:
    query = {"format": file_format, **named} | ({} if component is None else {"component": component})
    answer = server.http.get(f"/v1/fits/{fitted}/export", params=query)
    kind = FORMATS[file_format]
    assert answer.content == export_model(part_of(model, component), file_format, **named)
    assert answer.headers["content-type"] == kind.media_type
    assert f"{component or ''}.{kind.suffix}" in answer.headers["content-disposition"]


def test_merl_table_is_computed_once(model: dsbrdf.DSBRDF, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected, computed = encode_merl(model.tabulate()), []
    grid = dsbrdf.DSBRDF.evaluate_grid

    def counted(self: dsbrdf.DSBRDF, theta_half: Array, *rest: Array) -> Iterator[Array]:
        computed.extend(theta_half.tolist())
        return grid(self, theta_half, *rest)

    monkeypatch.setattr(dsbrdf.DSBRDF, "evaluate_grid", counted)

    assert b"".join(merl_parts(model, tmp_path)) == expected
    assert computed == THETA_HALF.tolist()
    assert not list(tmp_path.iterdir())
