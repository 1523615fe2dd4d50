"""Measurements: MERL files, RGL files and tables, what is stored of them, given back, refused, damaged and deleted."""

import hashlib
import os
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path

import httpx
import numpy as np
import pytest

import dsbrdf
import examples
from dsbrdf import MeasurementFormatError, read_samples
from dsbrdf.output import from_json
from dsbrdf.samples.reading import parse_samples
from dsbrdf_service.client import Client
from tests.library.samples.test_layouts import OTHER_KINDS
from tests.library.samples.test_spreadsheet import XLSX
from tests.support.models import assert_same_bits, mixture, samples_table, scattered_samples
from tests.support.server import QUICK, Server, StartServer, assert_problem
from tests.support.soak import repeats

pytestmark = pytest.mark.slow


EXAMPLE = Path(examples.__file__).with_name("satin_purple.bsdf")
FEW_LOBES = {"n_lobes": "1", "ring_lobes": "0"}


@pytest.fixture(scope="module")
def table() -> bytes:
    return samples_table(scattered_samples(mixture(2, 0), 60))


def post(server: Server, content: bytes, name: str, kind: str = "application/octet-stream") -> httpx.Response:
    return server.http.post("/v1/measurements", params={"name": name}, content=content, headers={"Content-Type": kind})


def test_an_rgl_file_is_stored_as_the_merl_table_of_its_values(server: Server, satin_purple_file: Path) -> None:
    merl = satin_purple_file.read_bytes()
    answer = post(server, EXAMPLE.read_bytes(), "paint.BSDF", "text/csv")  # The content decides.
    assert answer.status_code == 201, answer.text
    document = answer.json()
    assert document["name"] == "paint"
    assert document["sha256"] == hashlib.sha256(merl).hexdigest()
    assert document["size"] == len(merl)
    assert document["valid_nodes"] == dsbrdf.parse_merl(merl).valid.sum()
    assert server.http.get(f"{answer.headers['location']}/content").content == merl
    picture = server.http.get(f"{answer.headers['location']}/figures/sphere.png?size=16")
    assert picture.headers["content-type"] == "image/png"


def test_a_spreadsheet_is_the_table_in_it(server: Server) -> None:
    answer = post(server, XLSX, "felt.csv", "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet")
    assert answer.status_code in (200, 201), answer.text
    place = answer.headers["location"]
    found = np.load(BytesIO(server.http.get(f"{place}/samples.npy").content))
    np.testing.assert_allclose(found[:, 6:], parse_samples(XLSX).values, rtol=1e-6)
    file = server.http.get(f"{place}/content")
    assert file.content == parse_samples(XLSX).encode()


def test_table_is_fitted_after_a_kill_as_by_the_library_without_pictures(own_server: StartServer, table: bytes) -> None:
    server = own_server()
    uploaded = post(server, table, "felt.csv")
    server.stop(9)
    server.start()
    file = server.http.get(f"{uploaded.headers['location']}/content").content
    assert file == parse_samples(table).encode()
    assert len(file) == uploaded.json()["size"]

    headers = {"Content-Type": "text/csv", "Prefer": "wait=60"}
    answer = server.http.post("/v1/fits", params=FEW_LOBES | {"name": "felt.csv"}, content=table, headers=headers)
    fit = server.ended(answer).json()
    assert (fit["status"], fit["name"]) == ("succeeded", "felt"), fit
    document = {"measurement": uploaded.json()["sha256"], "options": {"n_lobes": 1, "ring_lobes": 0}}
    assert server.http.post("/v1/fits", json=document).json()["id"] == fit["id"]
    expected = dsbrdf.fit(parse_samples(table), n_lobes=1, ring_lobes=0)
    exported = server.http.get(f"/v1/fits/{fit['id']}/export?format=json").text
    assert_same_bits(from_json(exported)[0], expected.model)
    assert fit["metrics"]["relative_rms"] == expected.report.metrics.relative_rms
    assert fit["warnings"] == [*expected.report.warnings]
    for path in ("figures/sphere.png", "table.npy"):
        answer = server.http.get(f"/v1/measurements/{fit['measurement']}/{path}")
        assert "a table of samples, without pictures" in assert_problem(answer, 404)
    for figure in ("residual", "parameters"):
        assert b"felt" in server.http.get(f"/v1/fits/{fit['id']}/figures/{figure}.svg").content, figure
    assert server.http.get(f"/v1/fits/{fit['id']}/figures/sphere.png?size=16").is_success


@pytest.mark.parametrize(
    ("name", "content", "status", "words"),
    [
        ("a.bsdf", EXAMPLE.read_bytes()[:100_000], 422, "damaged or cut off"),
        ("a.csv", b"theta_in,theta_out,value\n" + b",,\n" * repeats(20_000, 2_000_000), 422, "0 samples"),
        ("a.txt", bytes(range(256)) * 100, 422, "MERL"),
        ("a.csv", b"#" * ((1 << 23) + 1), 413, "at most 8388608 bytes here"),
    ],
    ids=["cut off", "rows without end", "no text", "too long"],
)
def test_wrong_file_is_told_and_not_stored(server: Server, name: str, content: bytes, status: int, words: str) -> None:
    before = sorted(server.files())
    assert words in assert_problem(post(server, content, name), status)  # The client waits a minute at most.
    assert sorted(server.files()) == before


@pytest.mark.parametrize("path", OTHER_KINDS, ids=lambda path: path.stem)
def test_another_kind_of_file_is_named_as_by_the_library(server: Server, path: Path) -> None:
    with pytest.raises(MeasurementFormatError) as caught:
        read_samples(path)
    for place in ("/v1/measurements", "/v1/tables"):
        answer = server.http.post(
            place, content=path.read_bytes(), headers={"Content-Type": "application/octet-stream"}
        )
        assert str(caught.value) in assert_problem(answer, 422)


def test_the_options_of_a_table_are_those_of_its_upload(server: Server, table: bytes, data: bytes) -> None:
    on_a_grid = server.http.post("/v1/measurements", params={"scale": "0.5"}, content=data)
    assert "scale is an option of a table of samples" in assert_problem(on_a_grid, 422)
    odd = table.replace(b"blue", b"azure", 1) + b"0,0,1,0,0,1,-9,-9,-9\n"
    chosen = {"columns": "blue=azure", "missing": "-9", "scale": "0.5", "cosine": "out", "phi": "mirror"}
    assert "lacks blue: not understood are its columns" in assert_problem(post(server, odd, "odd.csv"), 422)
    headers = {"Content-Type": "text/csv", "Prefer": "wait=60"}
    fit = server.ended(server.http.post("/v1/fits", params=FEW_LOBES | chosen, content=odd, headers=headers)).json()
    assert fit["status"] == "succeeded", fit
    assert not {*chosen} & {*fit["options"]}
    options = {"n_lobes": 1, "ring_lobes": 0}
    again = server.http.post("/v1/fits", json={"measurement": fit["measurement"], "options": options})
    assert again.json()["id"] == fit["id"]
    refused = server.http.post("/v1/fits", json={"measurement": fit["measurement"], "options": {"scale": 0.5}})
    assert "Unknown option 'scale'" in assert_problem(refused, 422)
    samples = parse_samples(table)
    values = 0.5 * samples.values / samples.omega_out[:, 2:]
    expected = np.hstack([samples.omega_in * [-1.0, -1.0, 1.0], samples.omega_out, values])
    of_table = server.http.get(f"/v1/measurements/{fit['measurement']}/samples.npy")
    np.testing.assert_allclose(np.load(BytesIO(of_table.content)), expected, rtol=1e-6, atol=1e-7)


def flip(path: Path) -> None:
    """Change one bit, and set the file's time back."""
    before = path.stat()
    content = bytearray(path.read_bytes())
    content[20_000_000] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


@pytest.fixture(scope="module")
def used(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> Iterator[tuple[Server, str, str]]:
    """A service with one measurement and a fit, and their ids; each test leaves the file whole."""
    with Server.running(tmp_path_factory.mktemp("damage") / "data") as server:
        fit = server.http.post("/v1/fits", params=QUICK, content=data).json()
        yield server, fit["measurement"], fit["id"]


Harm = Callable[[Path], object]
HARMS: list[Harm] = [Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:-1]), flip]


@pytest.mark.parametrize("harm", HARMS)
def test_every_reader_refuses_a_damaged_file(used: tuple[Server, str, str], data: bytes, harm: Harm) -> None:
    server, sha256, fit = used
    options = QUICK | {"mask": 0.01 * HARMS.index(harm)}  # No other test has a fit with these.
    stored = f"/v1/measurements/{sha256}"
    url = f"{stored}/content"
    senders, drawers = [{}, {"If-None-Match": f'"{sha256}"'}], [f"{stored}/figures/sphere.png"]
    drawers += [f"/v1/fits/{fit}/figures/{figure}" for figure in ("parameters.svg", "residual.svg")]
    drawers += [f"{stored}/{array}.npy" for array in ("table", "figures/sphere")]
    assert server.http.get(url).content == data  # so it was right not long ago
    (path,) = server.files()
    harm(path)
    answers = [server.http.get(url, headers=headers) for headers in senders]
    answers += [server.http.get(drawer) for drawer in drawers]
    (said,) = {assert_problem(answer, 404, "measurement-damaged") for answer in answers}
    assert server.http.head(url).status_code == 404
    error = server.submit(sha256, **options).json()["error"]
    assert error == {"origin": "system", "type": "MeasurementDamaged", "message": said}
    with Client(str(server.http.base_url)) as client:
        assert client.upload(data) == sha256  # it asks whether one is needed
    assert server.http.get(url).content == data
    for drawer in drawers[::4] if harm is flip else []:
        assert server.http.get(drawer).is_success, drawer
    assert harm is not flip or server.submit(sha256, **options).json()["status"] == "succeeded"


def test_download_survives_the_deletion_of_its_file(used: tuple[Server, str, str], data: bytes) -> None:
    server, sha256, _ = used
    head = f"GET /v1/measurements/{sha256}/content HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    with server.connection(head.encode()) as connection:
        answer = bytearray(connection.recv(1000))
        assert server.http.delete(f"/v1/measurements/{sha256}").status_code == 204
        while piece := connection.recv(1 << 20):  # the connection did not hold it all
            answer += piece
    assert answer.endswith(data)
    assert server.http.post("/v1/measurements", content=data).status_code == 201
