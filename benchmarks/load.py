"""A mixed load on a server: correct and wrong requests, as the programs of a laboratory send them."""

import gzip
import io
import random
import socket
import struct
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np

from dsbrdf.data import FILE_SIZE
from tests.support.server import QUICK

_KEPT = 20  # fits that a program keeps for its evaluations
_RAW = "application/octet-stream"
_NPY = "application/x-npy"
_POINTS = (1, 100, 10_000, 100_000)

Step = Callable[[], None]


@dataclass
class Tally:
    """The responses that the clients received, by method, route and status; wrong ones are faults, one sentence each.

    `fits` are some that have succeeded, the newest last.
    """

    answers: Counter[tuple[str, str, int]] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    fits: deque[str] = field(default_factory=lambda: deque(maxlen=_KEPT))

    def note(self, answer: httpx.Response) -> None:
        """Count a response; every status of 500 or more is a fault."""
        parts = [part if len(part) < 32 else "*" for part in answer.request.url.path.split("/")]
        self.answers[answer.request.method, "/".join(parts), answer.status_code] += 1
        if answer.status_code >= 500:
            answer.read()
            self.faults.append(f"{answer.request.method} {answer.request.url}: {answer.status_code} {answer.text}")

    def server_errors(self) -> int:
        """Return the number of responses with a status of 500 or more."""
        return sum(count for (_, _, status), count in self.answers.items() if status >= 500)


class Client:
    """One client program, which repeats a step of a few related requests.

    `bodies` are measurements that nobody else sends, with the same values.
    """

    def __init__(self, address: str, bodies: Sequence[bytes], tally: Tally, seed: int) -> None:
        self._http = httpx.Client(base_url=address, timeout=120, event_hooks={"response": [tally.note]})
        self._encoded: dict[tuple[int, str], bytes] = {}
        self._bodies = bodies
        self._tally = tally
        self._random = random.Random(seed)

    def run(self, step: Callable[["Client"], None], over: threading.Event) -> None:
        """Repeat a step until the end event is set."""
        with self._http:
            while not over.is_set():
                try:
                    step(self)
                except Exception as error:
                    self._tally.faults.append(f"{step.__name__}: {error!r}")

    def fit_file(self) -> None:
        """Send a file in one of the encodings, compute a short fit, use it, and remove old fits."""
        number = self._random.randrange(len(self._bodies))
        encoding = self._random.choice(("", "gzip"))
        options = {**QUICK, "mask": round(self._random.random(), 3)}
        headers = {"Content-Type": _RAW, "Prefer": "wait=100"} | ({"Content-Encoding": encoding} if encoding else {})
        content = self._body(number, encoding)
        answer = self._http.post("/v1/fits", params=options, headers=headers, content=content)
        self._expect(answer, 200, 201)
        self._keep(answer)
        if self._random.random() < 0.3:
            self._expect(self._http.delete(f"/v1/measurements/{answer.json()['measurement']}"), 204, 404, 409)

    def fit_stored(self) -> None:
        """Fit a stored measurement with the default options, and follow the events of the fit."""
        sha256 = self._upload()
        options = {"weighting": self._random.choice(("plain", "log")), "horizon_cutoff_deg": self._some_cutoff()}
        answer = self._post_fit(sha256, options)
        if self._random.random() < 0.5:
            with self._http.stream("GET", f"/v1/fits/{answer.json()['id']}/events") as events:
                for line in events.iter_lines():
                    if line.startswith("event: ") and line.split()[1] in ("succeeded", "failed", "cancelled"):
                        break
        fit = self._http.get(f"/v1/fits/{answer.json()['id']}", params={"wait": 100})
        self._expect(fit, 200)
        self._keep(fit)

    def change_mind(self) -> None:
        """Submit a long fit, and cancel it at a random moment."""
        sha256 = self._upload()
        fit_id = self._post_fit(sha256, {"n_lobes": 8, "horizon_cutoff_deg": self._some_cutoff()}).json()["id"]
        time.sleep(self._random.uniform(0.0, 1.5))
        self._expect(self._http.delete(f"/v1/fits/{fit_id}"), 200)
        if self._random.random() < 0.5:
            self._expect(self._http.delete(f"/v1/fits/{fit_id}"), 200, 404)

    def evaluate(self) -> None:
        """Request values of a fit, point by point and in batches, its lobes and its files."""
        if not self._tally.fits:
            time.sleep(0.5)
            return
        url = f"/v1/fits/{self._random.choice(tuple(self._tally.fits))}"
        for _ in range(20):
            point = {"theta_half_deg": self._random.uniform(0, 89), "theta_diff_deg": self._random.uniform(0, 89)}
            self._expect(self._http.get(f"{url}/brdf", params=point), 200, 404)
        count = self._random.choice(_POINTS)
        angles = np.random.default_rng(self._random.getrandbits(32)).uniform(0, 89, (count, 2))
        if count <= 10_000:
            document = {"theta_half_deg": angles[:, 0].tolist(), "theta_diff_deg": angles[:, 1].tolist()}
            self._expect(self._http.post(f"{url}/brdf", json=document), 200, 404)
        file = io.BytesIO()
        np.save(file, angles)
        headers = {"Content-Type": _NPY, "Accept": _NPY}
        self._expect(self._http.post(f"{url}/brdf", content=file.getvalue(), headers=headers), 200, 404)
        self._expect(self._http.get(f"{url}/components"), 200, 404)
        self._expect(self._http.get(f"{url}/export", params={"format": "json"}), 200, 404)
        if self._random.random() < 0.05:
            self._expect(self._http.get(f"{url}/export", params={"format": "merl"}), 200, 404)

    def look_around(self) -> None:
        """List everything, download a measurement, and request health and metrics."""
        for noun in ("fits", "measurements"):
            url: str | None = f"/v1/{noun}?limit=7"
            while url is not None:
                answer = self._http.get(url)
                self._expect(answer, 200)
                url = answer.links.get("next", {}).get("url")
        for item in self._http.get("/v1/measurements").json()["items"][:2]:
            self._expect(self._http.head(f"/v1/measurements/{item['sha256']}/content"), 200, 404)
            self._expect(self._http.get(f"/v1/measurements/{item['sha256']}/content"), 200, 404)
        for path in ("/health/live", "/health/ready", "/metrics", "/openapi.json", "/docs"):
            self._expect(self._http.get(path), 200)
        time.sleep(0.5)

    def tidy(self) -> None:
        """Delete the oldest fits, so that their number stays constant."""
        old = self._http.get("/v1/fits", params={"limit": 200}).json()["items"][3 * _KEPT :]
        for item in old:
            if item["status"] not in ("accepted", "running"):
                self._expect(self._http.delete(f"/v1/fits/{item['id']}"), 200, 404)
        time.sleep(1.0)

    def blunder(self) -> None:
        """Send a malformed request; the response must be a 4xx."""
        body = self._bodies[0]
        swapped = struct.pack("<3i", 180, 90, 90)
        not_a_number = struct.pack("<d", float("nan"))
        wrong: list[tuple[str, str, dict[str, Any]]] = [
            ("POST", "/v1/fits", {"content": body[:-1]}),
            ("POST", "/v1/fits", {"content": swapped + body[12:]}),
            ("POST", "/v1/measurements", {"content": body[:1_000_012] + not_a_number + body[1_000_020:]}),
            ("POST", "/v1/measurements", {"content": self._body(0, "gzip")[:-9], "headers": _encoded("gzip")}),
            ("POST", "/v1/measurements", {"content": _bomb(), "headers": _encoded("gzip")}),
            ("POST", "/v1/measurements", {"content": body[:1000], "headers": _encoded("br")}),
            ("POST", "/v1/fits", {"json": {"measurement": "0" * 64, "options": {}}}),
            ("POST", "/v1/fits", {"json": {"measurement": 7}}),
            ("POST", "/v1/fits", {"content": b"{", "headers": {"Content-Type": "application/json"}}),
            ("POST", "/v1/fits?n_lobes=99", {"content": b""}),
            ("GET", "/v1/fits/../../etc/passwd", {}),
            ("GET", f"/v1/fits/{'f' * 32}", {}),
            ("DELETE", f"/v1/measurements/{'0' * 64}", {}),
            ("PUT", "/v1/fits", {}),
            ("GET", "/v1/fits?limit=-1", {}),
        ]
        for method, url, request in self._random.sample(wrong, 4):
            with suppress(httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError):  # refused before the end
                answer = self._http.request(method, url, **request)
                if not 400 <= answer.status_code < 500:
                    self._tally.faults.append(f"{method} {url}: {answer.status_code} {answer.text[:300]}")
        time.sleep(0.2)

    def vanish(self) -> None:
        """Disconnect in the middle of an upload or of a stream of events."""
        base = self._http.base_url
        with socket.create_connection((base.host, base.port or 80)) as connection:
            if self._random.random() < 0.7:
                head = f"POST /v1/fits HTTP/1.1\r\nHost: {base.host}\r\nContent-Length: {FILE_SIZE}\r\n\r\n"
                size = int(FILE_SIZE * self._random.random() ** 2)
                connection.sendall(head.encode() + self._bodies[0][:size])
            elif self._tally.fits:
                head = f"GET /v1/fits/{self._tally.fits[-1]}/events HTTP/1.1\r\nHost: {base.host}\r\n\r\n"
                connection.sendall(head.encode())
                connection.recv(100)
            if self._random.random() < 0.5:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        time.sleep(self._random.uniform(0.0, 1.0))

    def _upload(self) -> str:
        answer = self._http.post("/v1/measurements", content=self._pieces(self._random.choice(self._bodies)))
        self._expect(answer, 200, 201)
        return str(answer.json()["sha256"])

    def _post_fit(self, sha256: str, options: dict[str, Any]) -> httpx.Response:
        document = {"measurement": sha256, "options": options}
        answer = self._http.post("/v1/fits", json=document, headers={"Prefer": "respond-async"})
        self._expect(answer, 200, 201, 202)
        return answer

    def _some_cutoff(self) -> float:
        return round(self._random.uniform(70, 85), 3)

    def _body(self, number: int, encoding: str) -> bytes:
        if (number, encoding) not in self._encoded:
            body = self._bodies[number]
            self._encoded[number, encoding] = gzip.compress(body, 1) if encoding else body
        return self._encoded[number, encoding]

    @staticmethod
    def _pieces(body: bytes) -> Iterator[bytes]:
        for start in range(0, len(body), 1 << 20):
            yield body[start : start + (1 << 20)]

    def _keep(self, fit: httpx.Response) -> None:
        if fit.json()["status"] == "succeeded":
            self._tally.fits.append(fit.json()["id"])
        else:
            self._tally.faults.append(f"a fit has not succeeded: {fit.text[:500]}")

    def _expect(self, answer: httpx.Response, *statuses: int) -> None:
        if answer.status_code not in statuses and answer.status_code < 500:  # those are noted already
            request = f"{answer.request.method} {answer.request.url}"
            self._tally.faults.append(f"{request}: {answer.status_code} {answer.text[:300]}")


CLIENT_STEPS: tuple[Callable[[Client], None], ...] = (
    Client.fit_file,
    Client.fit_file,
    Client.fit_stored,
    Client.change_mind,
    Client.evaluate,
    Client.evaluate,
    Client.look_around,
    Client.tidy,
    Client.blunder,
    Client.vanish,
)
"""The steps of the clients, each in a thread of its own."""


def _encoded(encoding: str) -> dict[str, str]:
    return {"Content-Type": _RAW, "Content-Encoding": encoding}


def _bomb() -> bytes:
    """A hundred megabytes of zeros."""
    return gzip.compress(bytes(100 << 20), 1)
