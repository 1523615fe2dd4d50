"""Lists: newest first, in pages that a cursor and a link lead through."""

from collections.abc import Iterator

import pytest

from tests.support.server import Server


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> Iterator[Server]:
    """A service with one measurement and five fits, named by their iterations; the tests come in order."""
    with Server.running(tmp_path_factory.mktemp("lists") / "data") as server:
        sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
        for number in range(1, 6):
            assert server.submit(sha256, n_lobes=1, em_iterations=number).status_code == 201
        yield server


def numbers(items: list[dict[str, dict[str, int]]]) -> list[int]:
    return [item["options"]["em_iterations"] for item in items]


def test_fits_are_listed_newest_first_page_by_page(filled: Server) -> None:
    whole = filled.http.get("/v1/fits")
    assert numbers(whole.json()["items"]) == [5, 4, 3, 2, 1]
    assert "link" not in whole.headers
    assert {"components", "model"}.isdisjoint(whole.json()["items"][0])

    found, url, pages = [], "/v1/fits?limit=2", 0
    while url:
        answer = filled.http.get(url)
        found += numbers(answer.json()["items"])
        url = answer.links.get("next", {}).get("url", "")
        pages += 1
    assert found == [5, 4, 3, 2, 1]
    assert pages == 3
    assert filled.http.get("/v1/fits?limit=5").links == {}


def test_page_cursor_stays_valid_when_fits_come_and_go(filled: Server) -> None:
    first = filled.http.get("/v1/fits?limit=2")
    items = first.json()["items"]
    sha256 = items[0]["measurement"]
    filled.submit(sha256, n_lobes=2, em_iterations=9)
    assert filled.http.delete(f"/v1/fits/{items[1]['id']}").json()["status"] == "deleted"
    second = filled.http.get(first.links["next"]["url"])
    assert numbers(second.json()["items"]) == [3, 2]


def test_measurements_are_listed(filled: Server, data: bytes) -> None:
    (item,) = filled.http.get("/v1/measurements").json()["items"]
    assert item["size"] == len(data)
    changed = data[:-8] + b"\0" * 8
    second = filled.http.post("/v1/measurements", content=changed).json()
    first_page = filled.http.get("/v1/measurements?limit=1")
    assert first_page.json()["items"] == [second]
    rest = filled.http.get(first_page.links["next"]["url"])
    assert rest.json()["items"] == [item]
