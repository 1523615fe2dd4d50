"""Clients that use all of a server's features, record what it has confirmed, and check it later."""

import io
import random
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Literal

import httpx
import numpy as np

import dsbrdf
from benchmarks.server.runner import Place, same_bits
from dsbrdf.data import FILE_SIZE
from tests.support.server import QUICK

TWO_LOBE_FIT: dict[str, Any] = {"method": "paper", "n_lobes": 2}
OPTIONS: tuple[dict[str, Any], ...] = (
    *({**QUICK, "mask": tenths / 10} for tenths in range(4)),
    TWO_LOBE_FIT,
    {"n_lobes": 2, "ring_lobes": 0},
)
"""Fits that clients ask for, with both methods; the last two take about a second, the others a fraction of it."""
LONG_FITS: tuple[dict[str, Any], ...] = ({"weighting": "log"}, {"n_lobes": 8, "horizon_cutoff_deg": 79.0})
"""Fits that a mixed load asks for beside them."""

_ACCEPTED = (200, 201, 202)
_PATIENCE = 10  # times half a minute
_NPY = "application/x-npy"
_N_POINTS = (1, 100, 10_000, 100_000)
_PAGES = ("/health/live", "/health/ready", "/metrics", "/openapi.json", "/docs", "/v1/fits", "/v1/measurements")

Promise = Literal["none", "kept", "cancelled", "gone", "unknown"]


@dataclass
class _Order:
    """A fit that a client has requested, and what the server has last confirmed about it."""

    options: dict[str, Any]
    model: dsbrdf.DSBRDF | None
    id: str = ""
    promise: Promise = "none"
    finished: str | None = None


_Action = Callable[[httpx.Client, _Order], object]


class StatefulClient:
    """One client with a measurement of its own, so that nobody else touches its fits.

    Before a request goes out that takes something back, what it takes back is not counted on any more; after an
    answer has come in, what it says is. With `models`, exported fits are compared with them; without, the client asks
    for long fits too, for values in batches and for all pages, sends malformed requests, and disconnects.
    """

    def __init__(self, number: int, place: Place, models: Sequence[dsbrdf.DSBRDF] = ()) -> None:
        self._place = place
        self._random = random.Random(place.random.random())
        self._body = place.variant(number)
        self._sha256 = ""
        self._stored: Promise = "none"
        self._orders = [_Order(options, model) for options, model in zip(OPTIONS, models, strict=False)]
        self._more: list[_Action] = []
        if not models:
            self._orders = [_Order(options, None) for options in (*OPTIONS, *LONG_FITS)]
            self._more = [*[self._evaluate] * 4, *[self._look_around] * 2, self._blunder, self._vanish]
        self.accepted = 0
        self.answers: Counter[int] = Counter()

    def run(self, address: str, over: threading.Event) -> None:
        """Send requests until the end event is set; after that, broken connections are no fault."""
        sending: list[_Action] = [self._send_and_fit, self._upload]
        using: list[_Action] = [*[self._fit] * 8, *[self._withdraw] * 2, *[self._look] * 4, self._values, self._discard]
        using += self._more
        with httpx.Client(base_url=address, timeout=120, event_hooks={"response": [self._count]}) as http:
            while not over.is_set():
                action = self._random.choice(sending + using if self._stored == "kept" else sending)
                try:
                    action(http, self._random.choice(self._orders))
                except httpx.TransportError as error:
                    self._place.expect(over.is_set(), f"{error!r} at {action} while the server was up")
                    return

    def _count(self, answer: httpx.Response) -> None:
        self.answers[answer.status_code] += 1
        if answer.status_code >= 500:
            self._want(answer)

    def settle(self, http: httpx.Client) -> int:
        """Check that the server has kept everything that it confirmed; return the number of confirmed fits."""
        if self._stored == "kept":
            self._want(http.head(f"/v1/measurements/{self._sha256}"), 200)
        for order in self._orders:
            if order.promise == "kept":
                ended = any(self._look(http, order, wait=30.0) not in ("accepted", "running") for _ in range(_PATIENCE))
                self._place.expect(ended, f"the fit {order.options} has not come to its end")
                exported = http.get(f"/v1/fits/{order.id}/export", params={"format": "json"})
                self._want(exported, 200)
                if order.model is not None and exported.status_code == 200:
                    same = same_bits(exported.text, order.model)
                    self._place.expect(same, f"the model of {order.options} is not the library's, bit for bit")
            else:
                self._look(http, order)
        return sum(order.promise == "kept" for order in self._orders)

    def _send_and_fit(self, http: httpx.Client, order: _Order) -> None:
        prefer = self._random.choice(("respond-async", "wait=1"))
        answer = self._ask(http, order, content=self._body, params=order.options, headers={"Prefer": prefer})
        self._want(answer, *_ACCEPTED)
        if answer.status_code in _ACCEPTED:
            self._stored, self._sha256 = "kept", answer.json()["measurement"]

    def _fit(self, http: httpx.Client, order: _Order) -> None:
        document = {"measurement": self._sha256 or "0" * 64, "options": order.options}
        answer = self._ask(http, order, json=document, headers={"Prefer": "respond-async"})
        self._want(answer, *_ACCEPTED, *(() if self._stored == "kept" else (404,)))

    def _ask(self, http: httpx.Client, order: _Order, **request: object) -> httpx.Response:
        before = order.promise
        if before != "kept":
            order.promise = "unknown"
        answer = http.post("/v1/fits", **request)  # type: ignore[arg-type]
        if answer.status_code in _ACCEPTED:
            order.id, order.promise = answer.json()["id"], "kept"
            if before != "kept":
                order.finished = None
                self.accepted += 1
        return answer

    def _upload(self, http: httpx.Client, _: _Order) -> None:
        if self._stored != "kept":
            self._stored = "unknown"
        answer = http.post("/v1/measurements", content=self._body)
        self._want(answer, 200, 201)
        self._stored, self._sha256 = "kept", answer.json()["sha256"]

    def _withdraw(self, http: httpx.Client, order: _Order) -> None:
        if not order.id:
            return
        before, order.promise = order.promise, "unknown"
        answer = http.delete(f"/v1/fits/{order.id}")
        self._want(answer, 200, *(() if before in ("kept", "cancelled") else (404,)))
        cancelled = answer.status_code == 200 and answer.json()["status"] == "cancelled"
        order.promise = "cancelled" if cancelled else "gone"

    def _look(self, http: httpx.Client, order: _Order, wait: float = 0.3) -> str:
        if not order.id:
            return "none"
        answer = http.get(f"/v1/fits/{order.id}", params={"wait": wait})
        state = answer.json()["status"] if answer.status_code == 200 else "gone"
        right = {
            "kept": ("accepted", "running", "succeeded"),
            "cancelled": ("cancelled",),
            "gone": ("gone",),
        }.get(order.promise)
        self._place.expect(
            right is None or state in right, f"a fit that was {order.promise} is {state}: {answer.text[:300]}"
        )
        if state == "succeeded" and order.promise == "kept":
            finished = answer.json()["finished"]
            self._place.expect(order.finished in (None, finished), "a finished fit was computed again")
            order.finished = finished
        return state

    def _values(self, http: httpx.Client, order: _Order) -> None:
        if order.finished is not None and order.promise == "kept":
            point = {"theta_half_deg": 5, "theta_diff_deg": 20}
            self._want(http.get(f"/v1/fits/{order.id}/brdf", params=point), 200)

    def _discard(self, http: httpx.Client, _: _Order) -> None:
        if self._stored != "kept":
            return
        self._stored = "unknown"
        answer = http.delete(f"/v1/measurements/{self._sha256}")
        self._want(answer, 204, 409)
        self._stored = "gone" if answer.status_code == 204 else "kept"

    def _evaluate(self, http: httpx.Client, order: _Order) -> None:
        """Request values in a batch, components and files."""
        if order.finished is None or order.promise != "kept":
            return
        url, file = f"/v1/fits/{order.id}", io.BytesIO()
        np.save(file, np.random.default_rng(0).uniform(0, 89, (self._random.choice(_N_POINTS), 2)))
        headers = {"Content-Type": _NPY, "Accept": _NPY}
        self._want(http.post(f"{url}/brdf", content=file.getvalue(), headers=headers), 200)
        self._want(http.get(f"{url}/components"), 200)
        self._want(http.get(f"{url}/export", params={"format": self._random.choice(("json", "merl"))}), 200)

    def _look_around(self, http: httpx.Client, _: _Order) -> None:
        """Request pages, and download the measurement."""
        for path in _PAGES:
            self._want(http.get(path), 200)
        self._want(http.get(f"/v1/measurements/{self._sha256}/content"), 200)

    def _blunder(self, http: httpx.Client, _: _Order) -> None:
        """Send a malformed request; the response must be a 4xx."""
        body = self._body
        swapped, not_a_number = struct.pack("<3i", 180, 90, 90), struct.pack("<d", float("nan"))
        wrong: list[tuple[str, str, dict[str, Any]]] = [
            ("POST", "/v1/fits", {"content": body[:-1]}),
            ("POST", "/v1/fits", {"content": swapped + body[12:]}),
            ("POST", "/v1/measurements", {"content": body[:1_000_012] + not_a_number + body[1_000_020:]}),
            ("POST", "/v1/measurements", {"content": body[:1000], "headers": {"Content-Encoding": "br"}}),
            ("POST", "/v1/fits", {"json": {"measurement": "0" * 64, "options": {}}}),
            ("POST", "/v1/fits", {"content": b"{", "headers": {"Content-Type": "application/json"}}),
            ("POST", "/v1/fits?n_lobes=99", {"content": b""}),
            ("GET", "/v1/fits/../../etc/passwd", {}),
            ("PUT", "/v1/fits", {}),
            ("GET", "/v1/fits?limit=-1", {}),
        ]
        method, url, request = self._random.choice(wrong)
        with suppress(httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError):  # refused before the end
            self._want(http.request(method, url, **request), *range(400, 500))

    def _vanish(self, http: httpx.Client, order: _Order) -> None:
        """Disconnect in the middle of an upload or of a stream of events."""
        if order.id and self._random.random() < 0.5:
            base = http.base_url
            with socket.create_connection((base.host, base.port or 80)) as connection:
                connection.sendall(f"GET /v1/fits/{order.id}/events HTTP/1.1\r\nHost: {base.host}\r\n\r\n".encode())
                connection.recv(100)
        else:
            size = int(FILE_SIZE * self._random.random() ** 2)
            vanish(http.base_url, self._body, size, abruptly=self._random.random() < 0.5)
        time.sleep(self._random.uniform(0.0, 1.0))

    def _want(self, answer: httpx.Response, *statuses: int) -> None:
        if answer.status_code not in statuses:
            answer.read()
            request = f"{answer.request.method} {answer.request.url.path}"
            self._place.expect(False, f"{request}: {answer.status_code} {answer.text[:300]}")


def vanish(base: httpx.URL, body: bytes, size: int, *, abruptly: bool) -> None:
    """Send the beginning of an upload and close the connection, normally or with a reset."""
    with socket.create_connection((base.host, base.port or 80)) as connection:
        head = f"POST /v1/measurements HTTP/1.1\r\nHost: {base.host}\r\nContent-Length: {len(body)}\r\n\r\n"
        connection.sendall(head.encode() + body[:size])
        if abruptly:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


@contextmanager
def running_clients(clients: Sequence[StatefulClient], address: str) -> Iterator[threading.Event]:
    """Let clients use a server; the event that they get is set when it is over, or before the server is ended."""
    over = threading.Event()
    with ThreadPoolExecutor(len(clients)) as pool:
        futures = [pool.submit(client.run, address, over) for client in clients]
        try:
            yield over
        finally:
            over.set()
    for future in futures:
        future.result()
