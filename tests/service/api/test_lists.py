"""Lists and names: pages newest first, names given with what is sent, shown, filtered by, and those of files."""

import pytest
from starlette.requests import Request

from dsbrdf import InvalidArgumentError
from dsbrdf_service.http.messages import content_disposition, given_name
from tests.support.merl_files import with_value
from tests.support.server import QUICK, Server


def names_of(server: Server, noun: str, **query: str) -> list[str | None]:
    return [item["name"] for item in server.http.get(f"/v1/{noun}", params=query).json()["items"]]


def test_name_is_shown_filtered_by_and_that_of_the_files(server: Server, data: bytes) -> None:
    other = with_value(data, 0.4)
    fit = server.http.post("/v1/fits", params={**QUICK, "name": "Näckel 1"}, content=other).json()
    assert fit["name"] == "Näckel 1"
    for noun in ("fits", "measurements"):
        assert names_of(server, noun, name="Näckel 1") == ["Näckel 1"]
    assert names_of(server, "fits", name="nobody's") == []
    file = server.http.get(f"/v1/measurements/{fit['measurement']}/content")
    assert file.headers["content-disposition"] == "attachment; filename*=UTF-8''N%C3%A4ckel%201.binary"

    # The same again is renamed, not fitted.
    named = {"Content-Disposition": 'attachment; filename="/data/mine/nickel.binary"'}
    again = server.http.post("/v1/fits", params=QUICK, content=other, headers=named)
    assert (again.status_code, again.json()["id"], again.json()["name"]) == (200, fit["id"], "nickel")
    assert server.http.post("/v1/measurements", content=other).json()["name"] == "nickel"
    assert names_of(server, "measurements", name="nickel") == ["nickel"]
    for query, name in (("format=json&component=layers", "nickel-layers.json"), ("format=merl", "nickel.binary")):
        export = server.http.head(f"/v1/fits/{fit['id']}/export?{query}")
        assert export.headers["content-disposition"] == f'attachment; filename="{name}"'

    # A fit of a stored measurement has its name, or one of its own, which it keeps if it is sent without a name.
    document = {"measurement": fit["measurement"], "options": {**QUICK, "em_iterations": 4}}
    assert server.http.post("/v1/fits", json=document).json()["name"] == "nickel"
    assert server.http.post("/v1/fits", json=document, params={"name": "b"}).json()["name"] == "b"
    assert server.http.post("/v1/fits", params={**QUICK, "em_iterations": 4}, content=other).json()["name"] == "b"
    page = server.http.get("/v1/fits", params={"name": "nickel", "limit": 1})
    assert page.links == {}
    assert [item["name"] for item in server.http.get("/v1/fits", params={"name": "b"}).json()["items"]] == ["b"]


@pytest.mark.parametrize(
    ("header", "name"),
    [
        ("", None),
        ("attachment; filename=nickel.binary", "nickel"),
        ('attachment; filename="a \\"b\\".binary"', 'a "b"'),
        ('attachment; filename="C:\\\\data\\\\nickel.binary"', "nickel"),
        ("attachment; filename=\"x\"; filename*=UTF-8''N%C3%A4ckel.binary", "Näckel"),
        ("attachment; filename=" + "Näckel".encode().decode("latin-1"), "Näckel"),
        (content_disposition('ä;"'), 'ä;"'),
        ('attachment; filename="never closed', '"never closed'),
        *((f"attachment; filename*={charset}''a", None) for charset in ("idna", "undefined")),
        *((f"attachment; filename*={charset}''a", "a") for charset in ("utf-7", "x" * 100)),
        (f"attachment; filename*{'9' * 900}=a; filename=b", "a"),
    ],
)
def test_name_of_a_file_is_read_from_its_header(header: str, name: str | None) -> None:
    assert given_name(with_disposition(header)) == name


@pytest.mark.parametrize("part", [";", ';"', '; a="', "; filename=", "=\\"])
def test_only_a_short_header_is_read_for_a_name(part: str) -> None:
    with pytest.raises(InvalidArgumentError, match="at most 1024 characters"):
        given_name(with_disposition(part * 1025))


def with_disposition(header: str) -> Request:
    headers = [(b"content-disposition", header.encode("latin-1"))]
    return Request({"type": "http", "query_string": b"", "headers": headers})


def numbers(items: list[dict[str, dict[str, int]]]) -> list[int]:
    return [item["options"]["em_iterations"] for item in items]


def test_fits_are_listed_newest_first_page_by_page(server: Server, stored: str) -> None:
    def submit(iterations: int) -> None:
        options = {"method": "paper", "n_lobes": 1, "em_iterations": iterations}
        document = {"measurement": stored, "options": options}
        assert server.http.post("/v1/fits", params={"name": "a&b"}, json=document).json()["status"] == "succeeded"

    for iterations in (11, 12, 13):
        submit(iterations)
    whole = server.http.get("/v1/fits", params={"name": "a&b", "limit": 3})
    assert numbers(whole.json()["items"]) == [13, 12, 11]
    assert whole.links == {}
    assert {"components", "model"}.isdisjoint(whole.json()["items"][0])
    page = server.http.get("/v1/fits", params={"name": "a&b", "limit": 1})
    pages = [numbers(page.json()["items"])]
    # The cursor stays valid when fits come and go.
    submit(14)
    assert server.http.delete(f"/v1/fits/{page.json()['items'][0]['id']}").json()["status"] == "deleted"
    while "next" in page.links and len(pages) < 9:
        page = server.http.get(page.links["next"]["url"])
        pages.append(numbers(page.json()["items"]))
    assert pages == [[13], [12], [11]]
