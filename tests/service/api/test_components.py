"""Components over HTTP: readable, adding up to the fit, absent without light."""

import json

import numpy as np
import pytest

import dsbrdf
from dsbrdf.components import LABELS
from dsbrdf.output import fit_from_json, to_json
from dsbrdf.output.documents import component_documents
from dsbrdf.output.serialize import layers_to_json
from dsbrdf_service.compute.computations import LoadedFit
from dsbrdf_service.errors import ProblemError
from tests.support.server import Server, assert_problem

POINTS: dict[str, list[float]] = {"theta_half_deg": [0, 0.5, 5, 40, 80], "theta_diff_deg": [0, 80, 20, 60, 5]}


def test_components_are_the_documents_of_the_library_and_lead_the_fits_document(
    server: Server, fitted: str, model: dsbrdf.DSBRDF
) -> None:
    items = server.http.get(f"/v1/fits/{fitted}/components").json()["items"]
    fit = server.http.get(f"/v1/fits/{fitted}").json()
    assert fit["components"] == items == json.loads(json.dumps(component_documents(model)))
    assert list(fit).index("components") < list(fit).index("model")


def test_values_of_the_components_add_up_to_the_fits(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    url = f"/v1/fits/{fitted}"
    decomposition = dsbrdf.decompose(model)
    parts = []
    for component in decomposition:
        values = server.http.post(f"{url}/components/{component.label}/brdf", json=POINTS).json()["values"]
        expected = component.evaluate(np.radians(POINTS["theta_half_deg"]), np.radians(POINTS["theta_diff_deg"]))
        np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-15)
        parts.append(values)
    whole = server.http.post(f"{url}/brdf", json=POINTS).json()["values"]
    np.testing.assert_allclose(np.sum(parts, axis=0), whole, rtol=1e-12)
    one = server.http.get(f"{url}/components/diffuse/brdf?theta_half_deg=5&theta_diff_deg=20").json()["values"]
    np.testing.assert_allclose(one[0], parts[-1][2], rtol=1e-12)


def test_a_component_without_light_is_not_found(server: Server, stored: str) -> None:
    fit = server.submit(stored, method="global", n_lobes=1, ring_lobes=0).json()
    labels = [component["label"] for component in fit["components"]]
    absent, there = next(label for label in LABELS if label not in labels), " and ".join(labels)
    url, point = f"/v1/fits/{fit['id']}", {"theta_half_deg": 5, "theta_diff_deg": 20}
    for answer in (
        server.http.get(f"{url}/components/{absent}/brdf", params=point),
        server.http.get(f"{url}/components/{absent}/brdf", params={"theta_half_deg": "x"}),
        server.http.post(f"{url}/components/{absent}/brdf", json=POINTS),
        server.http.get(f"{url}/export", params={"format": "merl", "component": absent}),
        server.http.get(f"{url}/figures/sphere.png", params={"component": absent}),
    ):
        detail = assert_problem(answer, 404, "not-found")
        assert detail == f"The fit has no component {absent}: it has {there}."
    assert_problem(server.http.get(f"{url}/components/specular%20lobe/brdf", params=point), 404, "not-found")


def test_the_layers_are_exported_as_a_model(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    answer = server.http.get(f"/v1/fits/{fitted}/export", params={"format": "json", "component": "layers"})
    assert answer.text == layers_to_json(dsbrdf.decompose(model).layers)
    assert "-layers.json" in answer.headers["content-disposition"]


def test_a_black_fit_has_no_components(model: dsbrdf.DSBRDF) -> None:
    black = dsbrdf.decompose(model.select((), with_delta=False))
    restored, _ = fit_from_json(to_json(black.model, None, black))
    with pytest.raises(ProblemError, match=r"^The fit has no component diffuse: it reflects no light\.$") as raised:
        LoadedFit(restored, None).part("diffuse")
    assert raised.value.kind == "not-found"
