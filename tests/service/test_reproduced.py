"""What the service answers, logs, counts and prints is what it has answered, logged, counted and printed before."""

import hashlib
import json
import re
import shlex
import shutil
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from matplotlib.image import imread

import dsbrdf
from dsbrdf.data import encode_merl
from dsbrdf_service.admin.commands import doctor, keys, purge
from dsbrdf_service.admin.serve import main as serve
from dsbrdf_service.storage.database import FILE_NAME
from dsbrdf_service.storage.store import Store
from dsbrdf_service.wire import DEFAULTS
from tests.support.command_line import run_main
from tests.support.merl_files import glossy_plastic
from tests.support.models import mixture, samples_table, scattered_samples
from tests.support.reproduced import assert_reproduced, digest
from tests.support.server import LOCAL, Server, add, new_key, npy

pytestmark = pytest.mark.slow
STORED = Path(__file__).parents[1] / "project/stored/1.0"
MEASUREMENT = hashlib.sha256(encode_merl(glossy_plastic())).hexdigest()
NOT_TOLD = ("date", "content-length", "x-request-id", "connection", "transfer-encoding")


AOI = [f"{light},{seen},{25 if seen else -999.5}" for light in (0, 30) for seen in range(0, 61, 2)]
REQUESTS = Path(__file__).with_name("requests.txt").read_text()
TALKS = {topic: talk.strip().splitlines() for topic, talk in re.findall(r"^# (.*)\n([^#]*)", REQUESTS, re.MULTILINE)}
DOCUMENTS = [line.replace("PLASTIC", MEASUREMENT).partition(": ") for line in TALKS.pop("bodies")]
BODIES: dict[str, tuple[str, bytes]] = {
    **{name: ("application/json", document.encode()) for name, _, document in DOCUMENTS},
    "table": ("text/csv", samples_table(scattered_samples(mixture(2, 0), 60))),
    "odd table": ("text/csv", "\n".join(["AOI [deg],AOR,reflectance", *AOI]).encode()),
    "no rows": ("text/csv", b"theta_in,theta_out,value\n"),
    "no text": ("application/octet-stream", bytes(range(256)) * 100),
    "nothing": ("application/json", b""),
    "nonsense": ("application/json", b"\xff\xfe"),
    "deep": ("application/json", b"[" * 20_000),
    "not finite": ("application/x-npy", npy(np.full((8, 16, 3), np.nan))),
    "too bright": ("application/x-npy", npy(np.full((8, 16, 3), 1e30))),
    "whole numbers": ("application/x-npy", npy(np.ones((8, 16, 3), int))),
    "npy": ("application/x-npy", npy([[0.0, 30.0], [10.0, 30.0]])),
    "npy of pairs": ("application/x-npy", npy([[[0.0, 0.6, 0.8], [0.0, 0.0, 1.0]]])),
    "npy too wide": ("application/x-npy", npy([[1.0, 91.0]])),
    "npy of vectors": ("application/x-npy", npy(np.ones(6))),
    "npy cut off": ("application/x-npy", npy(np.ones((3, 2)))[:-1]),
    "npy and more": ("application/x-npy", npy(np.ones((3, 2))) + b"1"),
    "npy of whole numbers": ("application/x-npy", npy(np.ones((3, 2), int))),
    "npy not unit": ("application/x-npy", npy(np.ones((3, 6)))),
    "npy not finite": ("application/x-npy", npy([[1.0, 1.0, np.inf]])),
    "panorama": ("application/x-npy", npy(np.linspace(0.0, 2.0, 8 * 16 * 3).reshape(8, 16, 3))),
    "no panorama": ("application/x-npy", npy(np.ones((8, 8, 3)))),
    "brighter": ("application/x-npy", npy(np.full((8, 16, 3), 2.0))),
    "black": ("application/x-npy", npy(np.zeros((8, 16, 3)))),
}


def requests_in(talk: Sequence[str]) -> Iterator[str]:
    for line in talk:
        parts = re.split(r"\[(.*?)\]", line)
        choices = [part.split(" ") if number % 2 else [part] for number, part in enumerate(parts)]
        yield from ("".join(chosen).replace("~", "") for chosen in product(*choices))


def conversed(talk: Sequence[str], ask: Callable[[str], object]) -> dict[str, object]:
    """Return what is answered to each request, and to a repeated one again."""
    answers: dict[str, object] = {}
    for request in requests_in(talk):
        answers[request + ", again" * sum(asked.partition(", again")[0] == request for asked in answers)] = ask(request)
    return answers


class Conversation:
    """Requests to one service; what differs between two runs has a name in the answers, numbered as it appears."""

    def __init__(self, server: Server, data: bytes) -> None:
        self.server, self.usual = server, dict[str, str]()
        self.names, self.said, self.request = dict[str, str](), dict[str, str](), ""
        self.bodies = {**BODIES, "plastic": ("application/octet-stream", data)}
        keys: dict[str, dict[str, int]] = {
            "key": {},
            "small": {"stored_mb": 1},
            "patient": {"queued_fits": 0},
            "watcher": {"metrics": 1},
        }
        self.given = {name: new_key(server, name, **limits)[1]["Authorization"] for name, limits in keys.items()}
        self.given |= {"long": "x" * 9000, "point": "theta_half_deg=10&theta_diff_deg=30", "missing": "0" * 64}
        self.given |= {"missing_fit": "0" * 32, "plastic": MEASUREMENT}
        for path in ("fits?status=succeeded", "fits?status=failed", "materials"):
            fit = server.http.get(f"/v1/{path}").json()["items"][-1]
            self.given[path.partition("=")[2] or path] = fit["id"]

    def ask(self, request: str) -> dict[str, Any]:
        self.request = request
        target, *more = (part.format_map(self.given) for part in request.split(" | "))
        headers = dict(part.replace("%20", " ").split(": ") for part in more if ": " in part)
        name = next((part for part in more if ": " not in part), "")
        kind, body = self.bodies[name.replace("_", " ")] if name else ("", None)
        if kind or "Content-Type" in headers:
            headers.setdefault("Content-Type", kind)
        method, path = target.split(" ")
        sent = [(name.encode(), value.encode()) for name, value in headers.items() if value]
        answer = self.server.http.request(method, path, content=body, headers=sent)
        self.given["tag"] = answer.headers.get("etag", "")
        if name == "endless":  # Whether it has begun depends on the machine.
            self.server.until_running(answer.json()["id"])
            answer = self.server.http.request(method, path, content=body, headers=sent)
        if name and answer.is_success and answer.headers["content-type"] == "application/json":
            self.given.setdefault(name, answer.json().get("id") or answer.json().get("sha256"))
        return self.told(answer)

    def told(self, answer: httpx.Response) -> dict[str, Any]:
        """Return what an answer says; of its headers, those that differ from the first answer's."""
        all_headers = {name: self.masked(value) for name, value in answer.headers.items() if name not in NOT_TOLD}
        headers = {name: all_headers.get(name) for name in sorted({*all_headers, *self.usual})}
        told = {name: value for name, value in headers.items() if value != self.usual.get(name)}
        self.usual = self.usual or all_headers
        return {"status": answer.status_code, **told, "body": self.content(answer)}

    def content(self, answer: httpx.Response) -> Any:
        kind, content = answer.headers.get("content-type", "").partition(";")[0], answer.content
        if not content:
            return f"{answer.headers['content-length']} bytes" if kind == "application/octet-stream" else None
        if kind == "application/problem+json":
            problem = answer.json()
            assert (problem["status"], problem["instance"]) == (answer.status_code, answer.request.url.path)
            return self.masked("{title} ({type}): {detail}".format_map(problem))
        if kind == "application/json":
            return self.brief(answer.json())
        if kind == "application/x-npy":
            return digest(np.load(BytesIO(content)))
        if kind == "image/png":
            return digest(imread(BytesIO(content)))
        if kind == "text/event-stream":
            return re.findall("event: .*", answer.text)
        if kind.startswith("text/") and kind not in ("text/html", "text/javascript"):
            lines = [self.masked(line)[:120] for line in answer.text.splitlines()]
            return [*lines[:3], f"{len(lines)} lines"]
        return len(content) if kind == "application/octet-stream" else "..."

    def brief(self, value: Any) -> Any:
        """Return a document with digests of long lists of numbers, and the request that has been told a part before."""
        if isinstance(value, str):
            return self.masked(value)
        if isinstance(value, dict):
            value = {name: self.brief(one) for name, one in value.items() if name not in ("timings", "versions")}
        elif isinstance(value, list):
            try:
                value = digest(value) if np.size(np.asarray(value, float)) > 9 else value
            except (TypeError, ValueError):
                value = [*map(self.brief, value[:4]), *([f"{len(value)} in all"] if len(value) > 4 else [])]
        first = self.said.setdefault(str(value), self.request)
        return f"as in {first}" if first != self.request and len(str(value)) > 99 else value

    def masked(self, text: str) -> str:
        text = re.sub(r"\d{4}-\d\d-\d\dT[\d:.]+Z", "<time>", text.replace(str(self.server.data_dir), "<folder>"))
        text = text.replace(dsbrdf.__version__, "<version>")

        def named(found: re.Match[str]) -> str:
            known = {value: name for name, value in self.given.items()}
            return self.names.setdefault(found[0], f"<{known.get(found[0], len(self.names))}>")

        return re.sub(r"\b(?:[0-9a-f]{32}){1,2}\b", named, text)


def end_two_fits(folder: Path) -> None:
    """Beside the fit that a release has stored, put a failed and a cancelled one."""
    error = json.dumps({"origin": "input", "type": "FitError", "message": "No lobe fits."})
    with closing(sqlite3.connect(folder / FILE_NAME)) as db, db:
        db.execute("DELETE FROM measurements")
        db.execute("UPDATE fits SET measurement = ?", [MEASUREMENT])
        for seq, status in ((2, "failed"), (3, "cancelled")):
            values = ("", seq, status, str(seq) * 32, MEASUREMENT, json.dumps(DEFAULTS), status)
            columns = "owner, seq, name, id, measurement, options, status, algorithm, library, created, error"
            told = "1", "1", 1e9, error if status == "failed" else None
            db.execute(f"INSERT INTO fits ({columns}) VALUES ({', '.join('?' * 11)})", values + told)


@pytest.fixture
def conversation(tmp_path: Path, data: bytes) -> Iterator[Conversation]:
    folder = tmp_path / "data"
    folder.mkdir()
    shutil.copy(STORED / "dsbrdf.sqlite", folder / FILE_NAME)
    end_two_fits(folder)
    with Server.running(folder, host="127.0.0.2", workers="1", default_wait_seconds="0.1") as server:
        yield Conversation(server, data)


def test_conversation(conversation: Conversation) -> None:
    for topic in [*TALKS][:-1]:
        assert_reproduced(f"conversation/{topic}", conversed(TALKS[topic], conversation.ask), 1e-3)
    server = conversation.server
    metrics = [line for line in server.http.get("/metrics").text.splitlines() if "process_" not in line]
    timed = re.compile(r"_(sum|bucket|created)\b|_requests_total\{|_request_seconds_count|/health/")
    assert_reproduced("conversation/metrics", [line for line in metrics if not timed.search(line)])
    assert server.stop() == 0
    lines = [json.loads(line) for line in server.log.read_text().splitlines()]
    said = (conversation.masked(" ".join([line["event"], *line])) for line in lines)
    told = {re.sub(r"\d{4,}|(?<=\[)\d+(?=])", "<number>", words) for words in said}
    assert_reproduced("conversation/log", sorted(told))


def run_command(words: Sequence[str]) -> int:
    name, *arguments = words
    try:
        return {"serve": serve, "keys": keys, "purge": purge, "doctor": doctor}[name](arguments)
    except SystemExit as end:
        return int(end.code or 0)


def test_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("DSBRDF_DATA_DIR", "data")
    Path("file").touch()
    with closing(Store(Path("data"))) as store:
        store.add_fit(LOCAL, add(store), {}, 10)
    made = list[str]()

    def ask(command: str) -> list[str]:
        words = shlex.split(command.replace("%20", " ").format(long="x" * 101))
        words = [made[-1] if word == "last" else word for word in words]
        setting = dict(word.split("=") for word in words if word.startswith("DSBRDF_"))
        answer = run_main(run_command, *words[len(setting) :], **setting)
        made.extend(re.findall(r"the key (\w+) of", answer.stderr))
        text = re.sub(r"dsbrdf_\w{12}_[\w-]{43}|\b[0-9a-f]{12}\b", "<key>", f"{answer.stdout}{answer.stderr}")
        text = re.sub(r"\d{4}-\d\d-\d\d[T ][\d:.+]+", "<time>", text.replace(str(tmp_path), "<folder>"))
        return [f"ends with {answer.returncode}", *re.sub(r"[^\S\n]+|\s*\n *(?=[^\n]*[│╭╰])", " ", text).splitlines()]

    assert_reproduced("conversation/commands", conversed(TALKS["commands"], ask))
