"""Fits of measured materials that come with the service."""

import numpy as np
import pytest

import dsbrdf
from tests.support.guarded import Guarded
from tests.support.server import Server, assert_problem


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
        assert [part["label"] for part in document["components"]] == list(dsbrdf.decompose(result).labels)
        values = http.get(f"{path}/brdf?theta_half_deg=10&theta_diff_deg=30", headers=key).json()["values"]
        expected = result.model.evaluate(np.radians(10), np.radians(30))
        assert values[0] == pytest.approx(expected, rel=1e-12)
        assert http.get(f"{path}/export?format=glsl", headers=key).is_success
        assert items[0]["id"] not in http.get("/v1/fits", headers=key).text
        assert_problem(http.patch(path, json={"name": "mine"}, headers=key), 404, "not-found")
        assert_problem(http.delete(path, headers=key), 409, "fit-ended")
        assert http.get(path, headers=key).json() == document


def test_an_ill_formed_id_is_named(server: Server) -> None:
    assert "'abc' is no id of a fit" in assert_problem(server.http.get("/v1/fits/abc"), 404, "not-found")
    assert "'abc' is no id of a measurement" in assert_problem(server.http.get("/v1/measurements/abc"), 404)
    assert_problem(server.http.get("/v2/fits"), 404, "not-found")


def test_files_of_a_fit_have_different_names(server: Server, fitted: str) -> None:
    answers = [server.http.head(f"/v1/fits/{fitted}/export?format={name}") for name in ("csv", "components")]
    assert len({answer.headers["content-disposition"] for answer in answers}) == 2
