"""Pictures of fits are those of the library."""

from io import BytesIO
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from starlette.requests import Request

import dsbrdf
from dsbrdf import EnvironmentMap
from dsbrdf.extras import MissingExtraError, require
from dsbrdf.rendering import displayed, exposure, sphere_normals
from dsbrdf_service.http.messages import NPY
from dsbrdf_service.http.problems import KINDS, problem_of
from tests.support.points import npy
from tests.support.server import QUICK, Server, assert_problem

pytestmark = pytest.mark.slow


def assert_shows(answer: httpx.Response, expected: NDArray[np.float64]) -> None:
    assert answer.headers["content-type"] == "image/png"
    with Image.open(BytesIO(answer.content)) as image:
        assert np.abs(np.asarray(image) / 255.0 - expected).max() < 0.003


def test_a_sphere_is_that_of_the_library_as_a_picture_and_as_radiance_in_any_light(
    server: Server, fitted: str, stored: str, model: dsbrdf.DSBRDF, plastic: dsbrdf.Measurement
) -> None:
    light = np.random.default_rng(3).uniform(0.0, 2.0, (16, 32, 3)).astype(np.float32)
    around = EnvironmentMap.from_pixels(light)
    of_fit, of_measurement = f"/v1/fits/{fitted}/figures", f"/v1/measurements/{stored}/figures"
    mask = sphere_normals(24)[1]
    for figures, query, whole, part in (
        (of_fit, {}, model, model),
        (of_fit, {"component": "diffuse"}, model, dsbrdf.decompose(model)["diffuse"]),
        (of_measurement, {}, plastic, plastic),
    ):
        for lighting in ("three_lights", "environment", around):
            asked: dict[str, Any] = {"method": "POST", "content": npy(light), "headers": {"Content-Type": NPY}}
            if isinstance(lighting, str):
                asked = {"method": "GET", "params": {"lighting": lighting}}
            asked["params"] = {"size": "24", **query, **asked.get("params", {})}
            image, exposed = (dsbrdf.render_sphere(shown, lighting=lighting, size=24) for shown in (part, whole))
            radiance = server.http.request(url=f"{figures}/sphere.npy", **asked)
            assert radiance.headers["content-type"] == NPY
            assert np.load(BytesIO(radiance.content)) == pytest.approx(image, rel=1e-5, abs=1e-7)
            picture = server.http.request(url=f"{figures}/sphere.png", **asked)
            assert_shows(picture, displayed(image, exposure(exposed, mask)))
    assert_problem(server.http.get(f"/v1/measurements/{'0' * 64}/figures/sphere.png"), 404, "not-found")


def test_every_other_sphere_has_another_tag(server: Server, stored: str, fitted: str) -> None:
    for path, others in ((f"fits/{fitted}", ["component=diffuse"]), (f"measurements/{stored}", [])):
        url = f"/v1/{path}/figures/sphere.png?size=16"
        current = {"If-None-Match": server.http.get(url).headers["etag"]}
        assert server.http.get(url, headers=current).status_code == 304
        for other in (
            url.replace("size=16", "size=24"),
            *(f"{url}&{query}" for query in ("lighting=environment", *others)),
        ):
            assert server.http.get(other, headers=current).status_code == 200, other
        url, sent = url.replace(".png", ".npy"), {"Content-Type": NPY}
        lights = [npy(np.full((16, 32, 3), value)) for value in (1.0, 2.0)]
        tag = server.http.post(url, content=lights[0], headers=sent).headers["etag"]
        found = [server.http.post(url, content=light, headers={**sent, "If-None-Match": tag}) for light in lights]
        assert [answer.status_code for answer in found] == [304, 200]


def test_figures_are_drawn_and_names_are_no_formulas(server: Server, data: bytes) -> None:
    kind = {"Content-Type": "application/octet-stream", "Prefer": "wait=60"}
    query = {**QUICK, "em_iterations": 5, "name": "$$ and $x_{$"}
    fit = server.http.post("/v1/fits", params=query, content=data, headers=kind).json()["id"]
    first = {}
    for figure in ("parameters", "residual"):
        url = f"/v1/fits/{fit}/figures/{figure}.svg"
        answer = server.http.get(url)
        assert (answer.status_code, answer.headers["content-type"]) == (200, "image/svg+xml")
        assert answer.content.startswith(b"<?xml")
        first[figure] = answer.content
        assert server.http.get(url, headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    url = f"/v1/fits/{fit}/figures/parameters.svg"
    dark, light = server.http.get(f"{url}?dark=true").content, server.http.get(url).content
    assert light == first["parameters"]  # one tag, the same bytes
    assert b"#000000" in light
    assert b"#000000" not in dark  # no black marks
    assert b'z\n"/>' not in dark  # no areas without a colour, which are black


@pytest.mark.parametrize("figure", ["parameters.png", "profiles.svg", "sphere.svg"])
def test_there_are_no_other_figures(server: Server, fitted: str, figure: str) -> None:
    assert_problem(server.http.get(f"/v1/fits/{fitted}/figures/{figure}"), 404, "not-found")


def test_a_missing_library_is_named() -> None:
    with pytest.raises(MissingExtraError) as raised:
        require("plot", "no_such_library", purpose="figures")
    problem = problem_of(Request({"type": "http", "path": "/", "headers": []}), raised.value)
    assert (KINDS[problem.kind].status, problem.kind) == (501, "not-installed")
    assert "pip install 'dsbrdf[plot]'" in problem.detail
