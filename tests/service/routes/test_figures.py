"""Pictures of fits are those of the library."""

from io import BytesIO

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from starlette.requests import Request

import dsbrdf
from dsbrdf.extras import MissingExtraError, require
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import sphere_normals
from dsbrdf.output.sphere_panels import DIFFERENCE_GAIN
from dsbrdf_service.http.problems import KINDS, problem_of
from tests.support.server import QUICK, Server, assert_problem

pytestmark = pytest.mark.slow


def assert_shows(answer: httpx.Response, expected: NDArray[np.float64]) -> None:
    assert answer.headers["content-type"] == "image/png"
    with Image.open(BytesIO(answer.content)) as image:
        assert np.abs(np.asarray(image) / 255.0 - expected).max() < 0.003


@pytest.mark.parametrize("component", [None, "diffuse"])
def test_a_sphere_is_drawn_with_the_exposure_of_the_fit(
    server: Server, fitted: str, model: dsbrdf.DSBRDF, component: str | None
) -> None:
    query = {"size": "32", "lighting": "environment"} | ({} if component is None else {"component": component})
    answer = server.http.get(f"/v1/fits/{fitted}/figures/sphere.png", params=query)
    shown = model if component is None else dsbrdf.decompose(model)[component]
    whole, part = (dsbrdf.render_sphere(one, lighting="environment", size=32) for one in (model, shown))
    assert_shows(answer, displayed(part, exposure(whole, sphere_normals(32)[1])))


def test_the_sphere_of_a_measurement_has_its_own_exposure(
    server: Server, stored: str, plastic: dsbrdf.Measurement
) -> None:
    url = f"/v1/measurements/{stored}/figures/sphere.png"
    answer = server.http.get(url, params={"size": "32"})
    picture = dsbrdf.render_sphere(plastic, size=32)
    assert_shows(answer, displayed(picture, exposure(picture, sphere_normals(32)[1])))
    assert_problem(server.http.get(f"/v1/measurements/{'0' * 64}/figures/sphere.png"), 404, "not-found")


def test_spheres_side_by_side_have_one_exposure(
    server: Server, fitted: str, model: dsbrdf.DSBRDF, plastic: dsbrdf.Measurement
) -> None:
    radiance = [dsbrdf.render_sphere(shown, size=32) for shown in (plastic, model, *dsbrdf.decompose(model))]
    factor = exposure(radiance[0], sphere_normals(32)[1])
    measured, fit, *components = (displayed(image, factor) for image in radiance)
    difference = np.minimum(DIFFERENCE_GAIN * np.abs(fit - measured), 1.0)
    answer = server.http.get(f"/v1/fits/{fitted}/figures/spheres.png", params={"size": "32"})
    assert_shows(answer, np.concatenate([measured, fit, difference, *components], axis=1))


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


def test_figures_are_drawn_and_names_are_no_formulas(server: Server, data: bytes) -> None:
    kind = {"Content-Type": "application/octet-stream", "Prefer": "wait=60"}
    query = {**QUICK, "em_iterations": 5, "name": "$$ and $x_{$"}
    fit = server.http.post("/v1/fits", params=query, content=data, headers=kind).json()["id"]
    texts = {}
    for figure in ("components.svg", "lobes.svg", "parameters.svg", "profiles.svg", "residual.png"):
        url = f"/v1/fits/{fit}/figures/{figure}"
        answer = server.http.get(url)
        media_type, start = ("image/png", b"\x89PNG") if figure.endswith("png") else ("image/svg+xml", b"<?xml")
        assert (answer.status_code, answer.headers["content-type"]) == (200, media_type)
        assert answer.content.startswith(start)
        assert server.http.get(url, headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
        texts[figure] = answer.content
    again = server.http.get(f"/v1/fits/{fit}/figures/lobes.svg")
    assert again.content == texts["lobes.svg"]  # one tag, the same bytes
    title = b"components of the fit"
    assert (title in texts["components.svg"], title in texts["lobes.svg"]) == (True, False)


@pytest.mark.parametrize("figure", ["profiles.pdf", "spectrum.png", "sphere.svg"])
def test_there_are_no_other_figures(server: Server, fitted: str, figure: str) -> None:
    assert_problem(server.http.get(f"/v1/fits/{fitted}/figures/{figure}"), 404, "not-found")


def test_a_missing_library_is_named() -> None:
    with pytest.raises(MissingExtraError) as raised:
        require("plot", "no_such_library", purpose="figures")
    problem = problem_of(Request({"type": "http", "path": "/", "headers": []}), raised.value)
    assert (KINDS[problem.kind].status, problem.kind) == (501, "not-installed")
    assert "pip install 'dsbrdf[plot]'" in problem.detail
