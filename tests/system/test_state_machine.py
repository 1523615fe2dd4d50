"""Random lives of the job API against a real server: what it says is held against a simple model, over restarts too."""

import hashlib
import signal
import struct
from collections.abc import Callable
from contextlib import closing
from typing import Any

import httpx
import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from tests.support.server import QUICK, SLOW, Server, assert_problem
from tests.support.soak import repeats

N_CONTENTS = 2
OPTIONS: tuple[dict[str, Any], ...] = (QUICK, {**QUICK, "n_lobes": 2}, {**QUICK, "mask": 0.9}, SLOW)
ENDED = ("succeeded", "failed", "cancelled")

contents = st.integers(0, N_CONTENTS - 1)
options = st.integers(0, len(OPTIONS) - 1)


class Life(RuleBasedStateMachine):
    """What was stored and asked for, newest last, and how each fit is known to have ended (None: not yet seen)."""

    start: Callable[[], Server]
    files: list[bytes]
    ids: dict[tuple[int, int], str]  # of fits, by content and options: they must never change
    metrics: dict[str, Any]  # of fits that succeeded once: they must never change

    @initialize()
    def begin(self) -> None:
        self.server = self.start()
        self.measurements: dict[int, None] = {}
        self.fits: dict[tuple[int, int], str | None] = {}

    def teardown(self) -> None:
        """Everything unfinished comes to its end, and everything can be removed."""
        with closing(self.server):
            for key in list(self.fits):
                self.cancel(key) if OPTIONS[key[1]] is SLOW else self.see(key, wait=60)
                if key in self.fits:
                    assert self.fits[key] in ENDED
                    assert self.server.http.delete(self.path(key)).json()["status"] == "deleted"
            self.fits.clear()
            for content in self.measurements:
                assert self.server.http.delete(f"/v1/measurements/{self.sha256(content)}").status_code == 204
            self.measurements.clear()
            self.lists_and_files_are_those_of_the_model()

    # What a client does

    @rule(content=contents)
    def upload(self, content: int) -> None:
        answer = self.server.http.post("/v1/measurements", content=self.files[content])
        assert answer.status_code == (200 if content in self.measurements else 201)
        assert answer.json()["sha256"] == self.sha256(content)
        self.measurements.setdefault(content)

    @rule(content=contents, chosen=options, wait=st.sampled_from(["respond-async", "wait=0.2", "wait=60"]))
    def submit_a_stored_one(self, content: int, chosen: int, wait: str) -> None:
        key, known = (content, chosen), self.fits.get((content, chosen))
        wait = "respond-async" if OPTIONS[chosen] is SLOW else wait
        document = {"measurement": self.sha256(content), "options": OPTIONS[chosen]}
        answer = self.server.http.post("/v1/fits", json=document, headers={"Prefer": wait})
        if content not in self.measurements and (key not in self.fits or known == "cancelled"):
            assert_problem(answer, 404, "not-found")
        elif answer.status_code != 404:
            self.submitted(key, answer)
        else:  # it had been cancelled before it was seen to end, and its measurement is gone
            assert (known, content in self.measurements) == (None, False)

    @rule(content=contents, chosen=st.integers(0, len(OPTIONS) - 2))
    def submit_a_file(self, content: int, chosen: int) -> None:
        headers = {"Content-Type": "application/octet-stream", "Prefer": "wait=60"}
        answer = self.server.http.post("/v1/fits", params=OPTIONS[chosen], content=self.files[content], headers=headers)
        self.measurements.setdefault(content)
        self.submitted((content, chosen), answer)
        assert self.fits[content, chosen] == "succeeded"

    @precondition(lambda self: self.fits)
    @rule(data=st.data(), wait=st.sampled_from([0, 0.3]))
    def look_a_fit_up(self, data: st.DataObject, wait: float) -> None:
        key = data.draw(st.sampled_from(sorted(self.fits)))
        self.see(key, wait)
        points = {"theta_half_deg": 5, "theta_diff_deg": 20}
        values = self.server.http.get(f"{self.path(key)}/brdf", params=points)
        known = self.fits[key]
        assert values.status_code in ((200, 409) if known is None else (200,) if known == "succeeded" else (409,))

    @rule(content=contents, chosen=options)
    def remove_a_fit(self, content: int, chosen: int) -> None:
        key = (content, chosen)
        if key not in self.fits:
            if key in self.ids:
                assert_problem(self.server.http.get(self.path(key)), 404, "not-found")
                assert_problem(self.server.http.delete(self.path(key)), 404, "not-found")
        else:
            self.cancel(key)

    @rule(content=contents)
    def remove_a_measurement(self, content: int) -> None:
        answer = self.server.http.delete(f"/v1/measurements/{self.sha256(content)}")
        unfinished = [key for key, known in self.fits.items() if key[0] == content and known is None]
        if content not in self.measurements:
            assert_problem(answer, 404, "not-found")
        elif answer.status_code == 409:
            assert_problem(answer, 409, "measurement-in-use")
            assert unfinished
        else:
            assert answer.status_code == 204
            del self.measurements[content]
            for key in unfinished:
                assert self.see(key, 0) in ENDED

    @rule(number=st.sampled_from([signal.SIGTERM, signal.SIGKILL]))
    def restart(self, number: signal.Signals) -> None:
        self.server.stop(number)
        self.server.start()

    # What must be true at any time

    @invariant()
    def lists_and_files_are_those_of_the_model(self) -> None:
        listed = self.listed("/v1/measurements")
        assert [item["sha256"] for item in listed] == [self.sha256(content) for content in reversed(self.measurements)]
        fits = self.listed("/v1/fits")
        assert [item["id"] for item in fits] == [self.ids[key] for key in reversed(self.fits)]
        for item, known in zip(fits, reversed(self.fits.values()), strict=True):
            assert known in (None, item["status"])
        assert {path.stem for path in self.server.files()} == {self.sha256(content) for content in self.measurements}

    # The model's own steps

    def submitted(self, key: tuple[int, int], answer: httpx.Response) -> None:
        """Take in what a submission says; the statuses tell whether the fit is computed because of it."""
        document = answer.json()
        known = self.fits.get(key)
        assert self.ids.setdefault(key, document["id"]) == document["id"]
        assert answer.headers["location"] == self.path(key)
        if key not in self.fits or known == "cancelled":
            assert answer.status_code in (201, 202)
            self.fits.pop(key, None)  # it comes anew, at the head of the list
        elif known is None:
            assert answer.status_code in (200, 202)
        else:
            assert answer.status_code == 200
        assert (answer.status_code == 202) == (document["status"] not in ENDED)
        self.fits[key] = None
        self.ended(key, document)

    def see(self, key: tuple[int, int], wait: float) -> str:
        answer = self.server.http.get(self.path(key), params={"wait": wait})
        assert answer.status_code == 200
        return self.ended(key, answer.json())

    def ended(self, key: tuple[int, int], document: dict[str, Any]) -> str:
        status: str = document["status"]
        assert status != "failed", document["error"]
        assert self.fits[key] in (None, status)
        if status == "succeeded":
            assert self.metrics.setdefault(document["id"], document["metrics"]) == document["metrics"]
        self.fits[key] = status if status in ENDED else None
        return status

    def cancel(self, key: tuple[int, int]) -> None:
        """Cancel a fit if it is unfinished, or else delete it."""
        known = self.fits[key]
        answer = self.server.http.delete(self.path(key))
        if answer.json()["status"] == "cancelled":
            assert known is None
            self.fits[key] = "cancelled"
        else:
            assert answer.json()["status"] == "deleted"
            del self.fits[key]

    def path(self, key: tuple[int, int]) -> str:
        return f"/v1/fits/{self.ids[key]}"

    def sha256(self, content: int) -> str:
        return hashlib.sha256(self.files[content]).hexdigest()

    def listed(self, path: str) -> list[Any]:
        """Every item of a list, page by page."""
        items: list[Any] = []
        url: str | None = f"{path}?limit=2"
        while url is not None:
            answer = self.server.http.get(url)
            items += answer.json()["items"]
            url = answer.links.get("next", {}).get("url")
        return items


@pytest.fixture
def life(own_server: Callable[..., Server], data: bytes) -> type[Life]:
    files = [data[:-8] + struct.pack("<d", 0.25 + content) for content in range(N_CONTENTS)]

    class Here(Life):
        start = staticmethod(own_server)
        ids: dict[tuple[int, int], str] = {}  # noqa: RUF012 (shared by all lives on purpose)
        metrics: dict[str, Any] = {}  # noqa: RUF012

    Here.files = files
    return Here


def test_random_sequences_of_requests_match_the_model(life: type[Life]) -> None:
    lives = repeats(2, 600)
    # Lives are not shortened when one fails: with a real server it would take longer than reading the whole.
    run_state_machine_as_test(
        life, settings=settings(max_examples=lives, stateful_step_count=12, phases=(Phase.reuse, Phase.generate))
    )
