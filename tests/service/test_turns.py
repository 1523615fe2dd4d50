"""The place of a fit is free when its process has ended, however often the fit is cancelled before."""

import asyncio
from concurrent.futures import Future

import pytest
from anyio import CancelScope

from dsbrdf_service.queue import result_of

pytestmark = pytest.mark.anyio


class Process(Future[None]):
    """A process that ends some time after it was asked to."""

    def cancel(self) -> bool:
        return False


async def test_place_of_a_cancelled_fit_is_kept_until_its_process_has_ended() -> None:
    process = Process()
    asyncio.get_running_loop().call_later(0.1, process.set_result, None)
    with CancelScope() as scope:
        asyncio.get_running_loop().call_soon(scope.cancel)
        await result_of(process)
    assert scope.cancelled_caught
    assert process.done()
