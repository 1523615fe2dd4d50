"""The real service as a process of its own, what tests want to know of it, and what they put into its store."""

import io
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from subprocess import CompletedProcess
from types import MappingProxyType
from typing import Any

import httpx
import numpy as np
from numpy.typing import ArrayLike

from dsbrdf_service.admin.commands import keys
from dsbrdf_service.storage.database import Database
from dsbrdf_service.storage.files import Incoming
from dsbrdf_service.storage.keys import add_key
from dsbrdf_service.storage.schema import Caller
from dsbrdf_service.storage.store import Store
from dsbrdf_service.wire import DEFAULTS, to_wire
from tests.support import tasks
from tests.support.command_line import run_main
from tests.support.launcher import ForkedProcess, launcher
from tests.support.processes import alive, children, wait_until

# Fits that take no time, and minutes: a test that wants to find a fit unfinished should not have to hurry.
QUICK: dict[str, Any] = {"method": "paper", "n_lobes": 1, "em_iterations": 3}

CHANGED = {name: value for name, value in to_wire(tasks.ENDLESS).items() if value != DEFAULTS[name]}
ENDLESS: dict[str, Any] = {"method": "global", **CHANGED}
StartServer = Callable[..., "Server"]
"""Type of the fixture `own_server`."""


class Server:
    """One service process; `stop` and `start` keep its data folder.

    It is a fork of a process that has imported the service already, or, with an interpreter of its own, what
    ``python -m dsbrdf_service`` starts. So is the process from which fits are forked. `constants` of its modules have
    other values.
    """

    own_interpreter = False
    constants: Mapping[str, float] = MappingProxyType({})
    process: "subprocess.Popen[bytes] | ForkedProcess"

    def __init__(self, data_dir: Path, **environment: str) -> None:
        self.data_dir = data_dir
        self.environment = {f"DSBRDF_{name.upper()}": value for name, value in environment.items()}
        self.log = data_dir.parent / f"{data_dir.name}.log"
        self.http = httpx.Client()  # `connect` replaces it when the address is known.

    @classmethod
    @contextmanager
    def running(cls, data_dir: Path, **environment: str) -> "Iterator[Server]":
        server = cls(data_dir, **environment)
        try:
            yield server.start()
        finally:
            server.close()

    def start(self) -> "Server":
        self.connect(self.launch())
        wait_until(lambda: self.http.get("/health/ready").is_success, 60.0)
        return self

    def connect(self, begin: int) -> None:
        """Find out where the process listens, as its log says; it may not be ready."""

        def told() -> re.Match[str] | None:
            return re.search(r"Uvicorn running on (\S+)", self.log.read_bytes()[begin:].decode())

        wait_until(lambda: told() is not None or self.process.poll() is not None, 60.0)
        found = told()
        assert found, f"the server did not start:\n{self.log.read_text()}"
        self.http.close()
        # A connection is not used once more when the service may be about to close it.
        self.http = httpx.Client(base_url=found[1], timeout=120.0, limits=httpx.Limits(keepalive_expiry=0.5))

    def launch(self) -> int:
        """Start the process, without waiting for anything; return where its log begins."""
        arguments = ["--port", "0", "--data-dir", str(self.data_dir)]
        environment = {**os.environ, **self.environment}
        with self.log.open("ab") as log:
            begin = log.tell()
            if self.own_interpreter:
                command = [sys.executable, "-m", "dsbrdf_service", *arguments]
                self.process = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
            else:
                self.process = launcher("dsbrdf_service").launch(arguments, environment, self.log, self.constants)
        return begin

    def stop(self, number: int = signal.SIGTERM) -> int:
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(timeout=60)

    def close(self) -> None:
        self.http.close()
        if hasattr(self, "process"):
            self.stop(signal.SIGKILL)

    def connection(self, sent: bytes = b"", seconds: float = 60.0) -> socket.socket:
        url = self.http.base_url
        connection = socket.create_connection((url.host, url.port or 80), timeout=seconds)
        connection.sendall(sent)
        return connection

    def memory(self, which: str = "VmRSS") -> float:
        """Memory that the web process has, or VmHWM, the most that it has had [MB]."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.partition(f"{which}:")[2].split()[0]) / 1024

    def cpu_seconds(self) -> float:
        """Processor time of the web process: what its work costs, however busy the machine is otherwise."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def files(self) -> list[Path]:
        """Every stored or half-received measurement."""
        return [path for part in ("blobs", "tmp") for path in (self.data_dir / part).rglob("*") if path.is_file()]

    def helpers(self) -> set[int]:
        return set(children(self.process.pid))

    def processes(self) -> set[int]:
        """Process ids of the server and of all that it has started, orphans included: its log is their stderr."""
        found = set()
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):  # it has ended meanwhile
                if (folder / "fd/2").readlink() == self.log and alive(int(folder.name)):
                    found.add(int(folder.name))
        return found

    def workers(self) -> set[int]:
        """Process ids of what is being computed: fits, and what requests ask for."""
        return {pid for helper in self.helpers() for pid in children(helper)}

    def submit(self, measurement: str, prefer: str = "wait=60", **options: Any) -> httpx.Response:
        """Ask for a fit; the method is by default the one that takes a fraction of a second."""
        document = {"measurement": measurement, "options": {"method": "paper", **options}}
        answer = self.http.post("/v1/fits", json=document, headers={"Prefer": prefer})
        return self.ended(answer) if prefer == "wait=60" else answer

    def ended(self, answer: httpx.Response) -> httpx.Response:
        """Wait for a requested fit, however busy the machine is; an answer to anything else is returned as it is."""
        while answer.is_success and answer.json()["status"] in ("accepted", "running"):
            answer = self.http.get(f"/v1/fits/{answer.json()['id']}", params={"wait": 60})
        return answer

    def status(self, fit_id: str) -> str:
        status: str = self.http.get(f"/v1/fits/{fit_id}").json()["status"]
        return status

    def until_running(self, fit_id: str) -> None:
        wait_until(lambda: self.status(fit_id) != "accepted" and bool(self.workers()))
        assert self.status(fit_id) == "running"


def head_of_upload(length: int, path: str = "/v1/measurements", **headers: str) -> bytes:
    """Return the head of an upload whose body the test sends itself, perhaps not all of it."""
    lines = {"Host": "localhost", "Content-Length": str(length)}
    lines |= {name.replace("_", "-"): value for name, value in headers.items()}
    return "\r\n".join([f"POST {path} HTTP/1.1", *(f"{name}: {lines[name]}" for name in lines), "", ""]).encode()


def in_progress(server: Server) -> float:
    found = re.search(r"^dsbrdf_requests_in_progress (\S+)$", server.http.get("/metrics").text, re.MULTILINE)
    assert found is not None
    return float(found[1])


def assert_problem(response: httpx.Response, status: int, kind: str | None = None) -> str:
    """Check a problem document (RFC 9457) and return its sentence."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert set(problem) == {"type", "title", "status", "detail", "instance"}
    assert problem["status"] == status
    if kind is not None:
        assert problem["type"] == f"urn:dsbrdf:problem:{kind}"
    assert "Traceback" not in response.text
    detail: str = problem["detail"]
    assert detail
    return detail


@dataclass(frozen=True)
class Guarded:
    """A service that wants keys, and the headers that hold the keys of two users."""

    server: Server
    alice: dict[str, str]
    bob: dict[str, str]

    def new_key(self, name: str = "another", **limits: Any) -> dict[str, str]:
        return new_key(self.server, name, **limits)[1]


def new_key(server: Server, name: str, **limits: Any) -> tuple[str, dict[str, str]]:
    """Make a key beside a running service, and use it at once; return its id and the header that holds it."""
    database = Database(server.data_dir, exclusive=False)
    key_id, key = add_key(database, name, **limits)
    database.close()
    header = {"Authorization": f"Bearer {key}"}
    assert server.http.get("/v1/fits", headers=header).status_code == 200
    return key_id, header


def keys_command(*words: str) -> "CompletedProcess[str]":
    return run_main(keys, *words)


def npy(array: ArrayLike) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(array))
    return buffer.getvalue()


LOCAL = Caller()


def receive(store: Store, content: bytes = b"content") -> Incoming:
    incoming = Incoming(store.blobs.temporary)
    incoming.write(content)
    incoming.valid_nodes = 1
    incoming.close()
    return incoming


def add(store: Store, content: bytes = b"content", caller: Caller = LOCAL) -> str:
    incoming = receive(store, content)
    row, new = store.add_measurement(caller, incoming)
    incoming.discard()
    assert (new, row.owner) == (True, caller.owner)
    return row.sha256
