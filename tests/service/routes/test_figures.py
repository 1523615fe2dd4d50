"""Pictures of fits are those of the library."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import dsbrdf
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import sphere_normals
from dsbrdf.output.serialize import from_json
from tests.support.server import Server, assert_problem


@pytest.mark.parametrize("component", [None, "diffuse"])
def test_a_sphere_is_drawn_with_the_exposure_of_the_fit(server: Server, fitted: str, component: str | None) -> None:
    url = f"/v1/fits/{fitted}/figures/sphere.png"
    query = {"size": "32", "lighting": "environment"} | ({} if component is None else {"component": component})
    answer = server.http.get(url, params=query)
    assert answer.headers["content-type"] == "image/png"
    model = from_json(server.http.get(f"/v1/fits/{fitted}/export?format=json").text)[0]
    whole = dsbrdf.render_sphere(model, lighting="environment", size=32)
    factor = exposure(whole, sphere_normals(32)[1])
    part = whole
    if component is not None:
        part = dsbrdf.render_sphere(dsbrdf.decompose(model)[component], lighting="environment", size=32)
    with Image.open(BytesIO(answer.content)) as image:
        assert np.abs(np.asarray(image) / 255.0 - displayed(part, factor)).max() < 0.003
    again = server.http.get(url, params=query, headers={"If-None-Match": answer.headers["etag"]})
    assert again.status_code == 304


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ({"size": "1000"}, "256"),
        ({"lighting": "moon"}, "'environment'"),
        ({"component": "ring"}, "'diffuse'"),
        ({"hue": "1"}, "hue"),
    ],
)
def test_what_cannot_be_drawn_is_refused(server: Server, fitted: str, query: dict[str, str], words: str) -> None:
    answer = server.http.get(f"/v1/fits/{fitted}/figures/sphere.png", params=query)
    assert words in assert_problem(answer, 422, "invalid-argument")


def test_a_fit_that_does_not_exist_is_not_found(server: Server) -> None:
    assert_problem(server.http.get(f"/v1/fits/{'0' * 32}/figures/sphere.png"), 404, "not-found")
