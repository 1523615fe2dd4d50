"""Requests that meet in the middle of each other: what each is told stays true, and nothing is computed twice."""

import asyncio
import errno
import sqlite3
from collections.abc import AsyncIterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from anyio import CancelScope

import dsbrdf
from dsbrdf.engines import Fault
from dsbrdf.engines.engine import NOT_STARTED
from dsbrdf_service import queue as queue_module
from dsbrdf_service.compute.computations import ModelCache
from dsbrdf_service.errors import FitNotFoundError
from dsbrdf_service.queue import result_of
from dsbrdf_service.settings import Settings
from dsbrdf_service.storage.atlas import ATLAS
from dsbrdf_service.storage.schema import Caller, FitKey
from tests.support.application import MAX_WAIT_S, Race, until
from tests.support.models import random_model
from tests.support.server import add

pytestmark = pytest.mark.anyio
LOST = Fault("system", "ProcessLost", "The fit's process was ended from outside (SIGKILL).")


@pytest.fixture
async def place(tmp_path: Path) -> AsyncIterator[Race]:
    race = Race(tmp_path / "data")
    try:
        yield race
    finally:
        await race.queue.close()
        race.store.close()


async def test_fit_requested_during_its_cancellation_runs(place: Race, monkeypatch: pytest.MonkeyPatch) -> None:
    key = await place.submit()
    await place.until_it_runs()
    slow = place.slow_down(monkeypatch, "cancel_fit", 0.5, after=True)
    cancelling = asyncio.create_task(place.queue.cancel(key))
    await until(slow.there.is_set)  # the row is cancelled, its process is still to be ended
    again = asyncio.create_task(place.submit())
    assert await cancelling is not None
    assert await again == key
    row = await place.end(key)
    assert row.status == "succeeded"
    assert row.metrics == {"run": 2}


@pytest.mark.parametrize(("late", "cancellations"), [("complete_fit", 1), ("complete_fit", 2), ("start_fit", 1)])
async def test_cancelled_attempt_cannot_overwrite_the_next_one(
    place: Race, monkeypatch: pytest.MonkeyPatch, late: str, cancellations: int
) -> None:
    place.workers = 2  # the next attempt need not wait for its turn
    await place.queue.close()
    place.begin()
    slow = place.slow_down(monkeypatch, late, 0.3, 0.6)
    key = await place.submit()
    place.engine.go_on()
    await until(slow.there.is_set)  # a thread is about to write what is not true any more
    place.engine.holds = True
    runs = len(place.engine.begun)
    for _ in range(cancellations):
        cancelling = asyncio.create_task(place.queue.cancel(key))
        await until(lambda: place.store.fit(key).status == "cancelled")
        assert await place.submit() == key  # while the first attempt is still ending
        assert (await cancelling) is not None
    await until(slow.over.is_set)  # it has written
    row = await place.end(key)
    assert row.status == "succeeded"
    assert row.metrics == {"run": runs + 1}


@pytest.mark.parametrize("after", [False, True])
async def test_request_at_completion_gets_the_result(place: Race, monkeypatch: pytest.MonkeyPatch, after: bool) -> None:
    slow = place.slow_down(monkeypatch, "complete_fit", 10.0, after=after)
    key = await place.submit()
    place.engine.go_on()
    await until(slow.there.is_set)
    others = [asyncio.create_task(place.submit()) for _ in range(5)]
    assert {await other for other in others} == {key}
    slow.on.set()
    assert (await place.end(key)).status == "succeeded"
    assert len(place.engine.begun) == 1


async def test_wait_goes_on_if_a_fit_is_cancelled_and_sent_again(place: Race, monkeypatch: pytest.MonkeyPatch) -> None:
    key = await place.submit()
    await place.until_it_runs()
    slow = place.slow_down(monkeypatch, "fit", MAX_WAIT_S)
    waiting = asyncio.create_task(place.queue.wait(key, MAX_WAIT_S))
    await asyncio.sleep(0)
    await place.queue.cancel(key)
    await until(slow.there.is_set)
    assert await place.submit() == key
    slow.on.set()  # the row that is read now is the new one's
    place.engine.go_on()
    assert (await waiting).status == "succeeded"


@pytest.mark.parametrize("error", [sqlite3.OperationalError("disk I/O error"), OSError(5, "Input/output error")])
async def test_result_waits_for_the_disk(place: Race, monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    monkeypatch.setattr(queue_module, "_RETRY_DELAY_S", 0.01)
    complete = place.store.complete_fit
    failures = iter([error, error])

    def fail_twice(*arguments: Any) -> Any:
        for failure in failures:
            raise failure
        return complete(*arguments)

    monkeypatch.setattr(place.store, "complete_fit", fail_twice)
    row = await place.end(await place.submit())
    assert (row.status, len(place.engine.begun)) == ("succeeded", 1)


@pytest.mark.parametrize(
    "harm",
    ["UPDATE fits SET options = '{' WHERE id = ?", "ALTER TABLE fits RENAME COLUMN metrics TO other -- ?"],
    ids=["row", "column"],
)
async def test_row_that_cannot_be_read_fails_and_lets_others_run(place: Race, harm: str) -> None:
    first = await place.submit()
    await place.until_it_runs()
    second = await place.submit(options=dsbrdf.FitOptions(mask=0.1))
    with place.store.database.transaction() as db:
        db.execute(harm, (second.id,) if "WHERE" in harm else ())
    place.engine.go_on()

    def ends() -> dict[str, tuple[str, str | None]]:
        rows = place.store.database.rows("SELECT id, status, error ->> 'type' FROM fits")
        return {key: (status, error) for key, status, error in rows}

    await until(lambda: ends()[second.id] == ("failed", "RowDamaged"))
    assert "ALTER" in harm or ends()[first.id] == ("succeeded", None)


async def test_fit_waits_for_a_folder_that_is_away(place: Race, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(queue_module, "_RETRY_DELAY_S", 0.01)
    blobs, away = place.store.folder / "blobs", place.store.folder / "away"
    blobs.rename(away)
    key = await place.submit()
    await asyncio.sleep(0.1)
    assert (place.store.fit(key).status, place.engine.begun) == ("running", [])
    away.rename(blobs)
    assert (await place.end(key)).status == "succeeded"


async def test_engine_exception_is_a_system_fault(place: Race) -> None:
    place.engine.outcomes += [RuntimeError("can't start new thread")]
    row = await place.end(await place.submit())
    assert (row.status, row.attempts) == ("succeeded", 2)
    place.engine.outcomes += [RuntimeError("can't start new thread")] * 2
    place.store.remove_fit(row.key)
    row = await place.end(await place.submit())
    assert row.error is not None
    assert (row.error["origin"], row.error["type"]) == ("system", "EngineFailed")


async def test_fit_is_retried_when_processes_cannot_be_started(place: Race, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(queue_module, "_RETRY_DELAY_S", 0.01)
    not_started = Fault("system", NOT_STARTED, "The fit's process could not be started: no more processes.")
    too_many = OSError(errno.EMFILE, "Too many open files")
    place.engine.outcomes += [not_started, too_many, not_started]
    row = await place.end(await place.submit())
    assert (row.status, row.attempts) == ("succeeded", 1)


async def test_queued_fits_alternate_between_owners(place: Race) -> None:
    callers = [Caller("many"), Caller("one"), Caller("two")]
    for caller in callers:
        add(place.store, caller=caller)
    many, one, two = [
        [await place.submit(caller, dsbrdf.FitOptions(mask=(1 + n) / 10)) for n in range(count)]
        for caller, count in zip(callers, (5, 1, 2), strict=True)
    ]
    for key in (*many, *one, *two):
        await place.end(key)
    # The second of many was next when the others came; behind it they take turns.
    order = [*many[:2], *one, two[0], many[2], two[1], *many[3:]]
    assert place.engine.begun == [str(key) for key in order]


async def test_model_is_that_of_the_fit_as_it_is_now(place: Race) -> None:
    models = ModelCache(place.store, 8)
    key = await place.submit()
    await place.end(key)
    first = await models.get(key)
    assert await models.get(key) is first
    assert place.store.remove_fit(key)  # as another process does it
    with pytest.raises(FitNotFoundError):
        await models.get(key)
    await place.end(await place.submit())
    again = await models.get(key)
    assert await models.get(key) is again is not first
    of_package = FitKey("", next(iter(ATLAS)))
    assert await models.get(of_package) is await models.get(of_package)


async def test_only_the_models_that_were_used_last_are_kept(place: Race) -> None:
    models = ModelCache(place.store, 2)
    keys = [await place.submit(options=dsbrdf.FitOptions(mask=m)) for m in (0, 1, 2)]
    for key in keys:
        await place.end(key)
    first, second = [await models.get(key) for key in keys[:2]]
    assert await models.get(keys[0]) is first
    await models.get(keys[2])
    assert await models.get(keys[0]) is first
    assert await models.get(keys[1]) is not second


async def test_simultaneous_requests_for_values_share_one_evaluation(place: Race) -> None:
    models, model = ModelCache(place.store, 8), random_model()
    key = await place.submit()
    await place.end(key)
    angles = [np.random.default_rng(n).uniform(0.0, 0.7, (3, n)) for n in (1, 3, 2)]
    requests = [asyncio.create_task(models.evaluate(key, None, *given)) for given in angles]
    left = asyncio.create_task(models.evaluate(key, None, *angles[1]))
    unknown = asyncio.create_task(models.evaluate(FitKey("", "f" * 32), None, *angles[0]))
    await asyncio.sleep(0)
    left.cancel()
    for given, values in zip(angles, await asyncio.gather(*requests), strict=True):
        np.testing.assert_array_equal(values, model.evaluate(*given))
    with pytest.raises(FitNotFoundError):
        await unknown
    np.testing.assert_array_equal(await models.evaluate(key, None, *angles[0]), model.evaluate(*angles[0]))


async def test_restart_does_not_count_as_an_attempt(place: Race) -> None:
    key = await place.submit()
    for starts in range(1, 5):
        await until(lambda: len(place.engine.begun) == starts)  # noqa: B023 (called at once)
        await place.queue.close()
        place.begin()
        assert place.store.resume() == [key]
        row = place.store.fit(key)
        assert (row.status, row.attempts, row.started) == ("accepted", 0, None)
        await place.queue.start()
    place.engine.outcomes += [LOST]
    assert (await place.end(key)).status == "succeeded"


async def test_fit_requested_while_the_service_stops_is_left_to_its_next_start(place: Race) -> None:
    place.queue.release_waiters()
    tasks = asyncio.all_tasks()
    key = await place.submit()
    assert asyncio.all_tasks() == tasks
    assert place.store.fit(key).status == "accepted"
    assert await place.queue.cancel(key) == place.store.fit(key)
    assert place.store.fit(key).status == "cancelled"


async def test_fit_whose_process_is_lost_while_the_service_stops_is_left_to_its_next_start(place: Race) -> None:
    place.engine.outcomes += [LOST]
    tasks = asyncio.all_tasks()
    key = await place.submit()
    await place.until_it_runs()
    place.queue.release_waiters()
    place.engine.go_on()
    await until(lambda: asyncio.all_tasks() == tasks)
    assert (place.store.fit(key).status, place.engine.begun) == ("running", [key.id])


async def test_who_follows_a_fit_is_told_that_it_begins(place: Race) -> None:
    assert [row async for row in place.queue.watch(FitKey("", "0" * 32))] == []  # It was deleted.
    first = await place.submit()
    await place.until_it_runs()
    followed = place.queue.watch(await place.submit(options=dsbrdf.FitOptions(mask=0.1)))
    assert (await anext(followed)).status == "accepted"
    await place.queue.cancel(first)
    async with asyncio.timeout(20.0):
        assert (await anext(followed)).status == "running"


async def test_an_owner_may_wait_with_a_quarter_of_the_requests_and_is_answered_at_once_beyond(place: Race) -> None:
    key, quarter = await place.submit(), Settings().limit_concurrency // 4
    for _ in range(quarter):  # These make room again.
        await place.queue.wait(key, 0.0)
    waiting = []
    for _ in range(quarter):
        assert place.queue.has_room(key.owner)
        waiting.append(asyncio.create_task(place.queue.wait(key, MAX_WAIT_S)))
        await asyncio.sleep(0)
    assert not place.queue.has_room(key.owner)
    assert place.queue.has_room("another")
    async with asyncio.timeout(MAX_WAIT_S / 2):
        assert not (await place.queue.wait(key, MAX_WAIT_S)).ended
    place.engine.go_on()
    assert {row.status for row in await asyncio.gather(*waiting)} == {"succeeded"}


async def test_waiting_is_timed_and_never_negative_when_the_clock_is_set_back(place: Race) -> None:
    keys = [await place.submit(options=dsbrdf.FitOptions(mask=mask)) for mask in (0.1, 0.2)]
    await place.until_it_runs()
    with place.store.database.transaction() as db:
        db.execute("UPDATE fits SET created = created + 3600.0 WHERE status = 'accepted'")
    for key in keys:
        await place.end(key)
    (metric,) = place.meters.waiting.collect()
    assert [0.0 <= sample.value < 60.0 for sample in metric.samples if sample.name.endswith("_sum")] == [True]


class Process(Future[None]):
    """A process that ends some time after it was asked to."""

    def cancel(self) -> bool:
        return False


async def test_place_of_a_cancelled_fit_is_kept_until_its_process_has_ended() -> None:
    process = Process()
    asyncio.get_running_loop().call_later(0.1, process.set_exception, OSError("killed"))
    with CancelScope() as scope:
        asyncio.get_running_loop().call_soon(scope.cancel)
        await result_of(process)
    assert scope.cancelled_caught
    assert process.done()
