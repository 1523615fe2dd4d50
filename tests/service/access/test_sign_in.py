"""Signing in on the page: the key in a cookie, which serves pages of the service itself and nobody else."""

from pathlib import Path

import httpx
import pytest

from service.routes import page
from tests.support.application import application
from tests.support.guarded import Guarded
from tests.support.server import assert_problem

pytestmark = pytest.mark.anyio
FORM = {"Content-Type": "application/x-www-form-urlencoded"}


def address_of(guarded: Guarded) -> str:
    return str(guarded.server.http.base_url).rstrip("/")


def key_of(guarded: Guarded) -> str:
    return guarded.alice["Authorization"].removeprefix("Bearer ")


def cookie_of(guarded: Guarded) -> dict[str, str]:
    return {"Cookie": f"other=1; dsbrdf_key={key_of(guarded)}"}


def sign_in(guarded: Guarded, origin: str, wanted: str = "/") -> httpx.Response:
    headers = {**FORM, "Origin": origin}
    body = f"key={key_of(guarded)}&wanted={wanted}"
    # Not with the client that tests share, which would keep the cookie.
    return httpx.post(f"{address_of(guarded)}/sign-in", content=body, headers=headers)


def test_key_in_a_cookie_reads_as_one_in_the_header(guarded: Guarded) -> None:
    read = guarded.server.http.get
    assert read("/v1/fits", headers=cookie_of(guarded)).content == read("/v1/fits", headers=guarded.alice).content
    assert read("/", headers=cookie_of(guarded)).status_code == 200


@pytest.mark.parametrize("value", ["", "x", "dsbrdf_000000000000_" + "A" * 43])
def test_cookie_without_a_valid_key_counts_for_nothing(guarded: Guarded, value: str) -> None:
    answer = guarded.server.http.get("/v1/fits", headers={"Cookie": f"dsbrdf_key={value}"})
    assert_problem(answer, 401, "unauthorized")


def test_cookie_changes_something_for_pages_of_the_service_only(guarded: Guarded) -> None:
    own, path = {"Origin": address_of(guarded)}, f"/v1/fits/{'0' * 32}"
    foreign = [{}, {"Origin": "null"}, {"Origin": "http://elsewhere.example"}]
    foreign += [{**own, "Sec-Fetch-Site": site} for site in ("same-site", "cross-site", "none")]
    for sent in foreign:
        answer = guarded.server.http.delete(path, headers={**cookie_of(guarded), **sent})
        assert "pages of the service itself" in assert_problem(answer, 403, "foreign-origin")
    for sent in (own, {"Sec-Fetch-Site": "same-origin"}):
        assert_problem(guarded.server.http.delete(path, headers={**cookie_of(guarded), **sent}), 404, "not-found")


def test_sign_in_sets_a_cookie_that_scripts_cannot_read_and_is_secure_under_https(guarded: Guarded) -> None:
    answer = sign_in(guarded, address_of(guarded), f"/fits/{'0' * 32}")
    assert (answer.status_code, answer.headers["location"]) == (303, f"./fits/{'0' * 32}")
    assert answer.headers["set-cookie"] == f"dsbrdf_key={key_of(guarded)}; HttpOnly; Path=/; SameSite=strict"
    origin = address_of(guarded).replace("http:", "https:")
    assert "; Secure" in sign_in(guarded, origin).headers["set-cookie"]


@pytest.mark.parametrize("wanted", ["//elsewhere.example", "https://elsewhere.example/", "/v1/fits", "/fits/..", ""])
def test_sign_in_leads_to_pages_of_the_service_only(guarded: Guarded, wanted: str) -> None:
    assert sign_in(guarded, address_of(guarded), wanted).headers["location"] == "./"


def test_sign_in_from_another_site_or_with_a_wrong_key_sets_nothing(guarded: Guarded) -> None:
    wrong = guarded.server.http.post("/sign-in", content="key=x", headers={**FORM, "Origin": address_of(guarded)})
    for answer, status in ((sign_in(guarded, "http://elsewhere.example"), 403), (wrong, 401)):
        assert answer.status_code == status
        assert "set-cookie" not in answer.headers
        assert 'role="alert"' in answer.text
        assert key_of(guarded) not in answer.text


async def test_form_that_does_not_arrive_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "_FORM_SECONDS", 0.05)
    async with application(tmp_path, monkeypatch) as running:
        answer = await running.ask("/sign-in", "", "POST", b"key=x", stalled=True).end()
        assert answer.status == 408
        assert b"longer than the 0.05 s" in answer.body


def test_sign_out_removes_the_cookie_but_not_for_pages_of_other_sites(guarded: Guarded) -> None:
    for sent in ({"Sec-Fetch-Site": "cross-site"}, {"Origin": "http://elsewhere.example"}):
        answer = guarded.server.http.post("/sign-out", headers={**cookie_of(guarded), **sent})
        assert_problem(answer, 403, "foreign-origin")
        assert "set-cookie" not in answer.headers
    answer = guarded.server.http.post("/sign-out", headers=cookie_of(guarded))
    assert answer.status_code == 303
    assert 'dsbrdf_key=""; ' in answer.headers["set-cookie"]
    assert "Max-Age=0" in answer.headers["set-cookie"]


def test_page_without_a_key_asks_for_it_and_the_api_answers_as_ever(guarded: Guarded) -> None:
    read = guarded.server.http.get
    page = read("/")
    assert (page.status_code, page.headers["www-authenticate"]) == (401, "Bearer")
    assert "<h1>Sign in</h1>" in page.text
    assert_problem(read("/", headers={"Authorization": "Bearer x"}), 401, "unauthorized")
    assert_problem(read(f"/fits/{'0' * 32}/view"), 401, "unauthorized")
