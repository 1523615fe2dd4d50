"""Clients that use all of a server's features, record what it has confirmed, and check it later."""

import random
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import httpx

import dsbrdf
from benchmarks.durability_series.harness import Harness, same_bits
from tests.support.server import QUICK

TWO_LOBE_FIT: dict[str, Any] = {"method": "paper", "n_lobes": 2}
OPTIONS: tuple[dict[str, Any], ...] = (
    *({**QUICK, "mask": tenths / 10} for tenths in range(4)),
    TWO_LOBE_FIT,
    {"n_lobes": 2, "ring_lobes": 0},
)
"""Fits that clients ask for, with both methods; the last two take about a second, the others a fraction of it."""

_ACCEPTED = (200, 201, 202)
_PATIENCE = 10  # times half a minute

Promise = Literal["none", "kept", "cancelled", "gone", "unknown"]


@dataclass
class _Order:
    """A fit that a client has requested, and what the server has last confirmed about it."""

    options: dict[str, Any]
    model: dsbrdf.DSBRDF
    id: str = ""
    promise: Promise = "none"
    finished: str | None = None


_Action = Callable[[httpx.Client, _Order], object]


class StatefulClient:
    """One client with a measurement of its own, so that nobody else touches its fits.

    Before a request goes out that takes something back, what it takes back is not counted on any more; after an
    answer has come in, what it says is.
    """

    def __init__(self, number: int, harness: Harness, models: Sequence[dsbrdf.DSBRDF]) -> None:
        self._harness = harness
        self._random = random.Random(harness.random.random())
        self._body = harness.variant(number)
        self._sha256 = ""
        self._stored: Promise = "none"
        self._orders = [_Order(options, model) for options, model in zip(OPTIONS, models, strict=True)]
        self.accepted = 0
        self.answers = 0

    def run(self, address: str, over: threading.Event) -> None:
        """Send requests until the end event is set; after that, broken connections are no fault."""
        sending: list[_Action] = [self._send_and_fit, self._upload]
        using: list[_Action] = [*[self._fit] * 8, *[self._withdraw] * 2, *[self._look] * 4, self._values, self._discard]
        with httpx.Client(base_url=address, timeout=60) as http:
            while not over.is_set():
                action = self._random.choice(sending + using if self._stored == "kept" else sending)
                try:
                    action(http, self._random.choice(self._orders))
                except httpx.TransportError as error:
                    self._harness.expect(over.is_set(), f"{error!r} at {action} while the server was up")
                    return
                self.answers += 1

    def settle(self, http: httpx.Client) -> int:
        """Check that the server has kept everything that it confirmed; return the number of confirmed fits."""
        if self._stored == "kept":
            self._want(http.head(f"/v1/measurements/{self._sha256}"), 200)
        for order in self._orders:
            if order.promise == "kept":
                ended = any(self._look(http, order, wait=30.0) not in ("accepted", "running") for _ in range(_PATIENCE))
                self._harness.expect(ended, f"the fit {order.options} has not come to its end")
                exported = http.get(f"/v1/fits/{order.id}/export", params={"format": "json"})
                self._want(exported, 200)
                same = exported.status_code == 200 and same_bits(exported.text, order.model)
                self._harness.expect(same, f"the model of {order.options} is not the library's, bit for bit")
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
        self._harness.expect(
            right is None or state in right, f"a fit that was {order.promise} is {state}: {answer.text[:300]}"
        )
        if state == "succeeded" and order.promise == "kept":
            finished = answer.json()["finished"]
            self._harness.expect(order.finished in (None, finished), "a finished fit was computed again")
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

    def _want(self, answer: httpx.Response, *statuses: int) -> None:
        request = f"{answer.request.method} {answer.request.url.path}"
        self._harness.expect(answer.status_code in statuses, f"{request}: {answer.status_code} {answer.text[:300]}")


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
