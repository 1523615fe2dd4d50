"""Clients that stop in the middle of a body or an answer cost next to no memory, however many they are."""

import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import numpy as np

from dsbrdf.data.merl import parse_merl
from dsbrdf.output.export import export_model
from dsbrdf.output.serialize import from_json
from tests.support.points import npy
from tests.support.processes import wait_until
from tests.support.server import QUICK, Server

CLIENTS = 6
MEGABYTES = 64


def in_progress(server: Server) -> float:
    found = re.search(r"^dsbrdf_requests_in_progress (\S+)$", server.http.get("/metrics").text, re.MULTILINE)
    assert found is not None
    return float(found[1])


def stalled(path: str, fit: str, data: bytes) -> Iterator[tuple[bytes, ...]]:
    """Requests that stop: a batch and an upload in the middle of their bodies, an export and a batch as answers."""
    batch, points = b"\x93NUMPY\1\0" + bytes(6_000_000), npy(np.zeros((200_000, 3)))
    head = "Host: x\r\nContent-Type: application/x-npy\r\nAccept: application/x-npy\r\nContent-Length:"
    upload = f"POST /v1/measurements HTTP/1.1\r\nHost: x\r\nContent-Length: {len(data)}\r\n\r\n"
    for _ in range(CLIENTS):
        yield f"POST {path}/brdf HTTP/1.1\r\n{head} 48000128\r\n\r\n".encode(), batch
        yield f"POST {path}/brdf HTTP/1.1\r\n{head} {len(points)}\r\n\r\n".encode(), points
        yield (f"GET {path}/export?format=merl HTTP/1.1\r\nHost: x\r\n\r\n".encode(),)
        yield upload.encode(), data[:1_000_000]


def test_stalled_clients_take_little_memory(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server(idle_timeout="600", least_upload_rate="0")
    fit = server.http.post("/v1/fits", params=QUICK, content=data).json()["id"]
    path = f"/v1/fits/{fit}"
    model = from_json(server.http.get(f"{path}/export?format=json").text)[0]
    table = server.http.get(f"{path}/export?format=merl")  # what any work takes once is no cost of the clients
    assert table.content == export_model(model, "merl")
    assert parse_merl(table.content).values.shape == (3, 90, 90, 180)
    before = server.memory()
    with ExitStack() as stack:
        for parts in stalled(path, fit, data):
            stack.enter_context(closing(server.connection(b"".join(parts))))
        wait_until(lambda: in_progress(server) > 2 * CLIENTS)
        assert server.memory() - before < MEGABYTES
        assert server.http.get(f"{path}/brdf?theta_half_deg=0&theta_diff_deg=0").status_code == 200
        print(f"\n{4 * CLIENTS} stalled clients: +{server.memory() - before:.0f} MB")
    wait_until(lambda: in_progress(server) == 1)
    assert not list((server.data_dir / "tmp").iterdir())
