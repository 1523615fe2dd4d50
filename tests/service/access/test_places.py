"""One caller's requests at once: who has too many comes again later, and not with all of them together."""

import asyncio

from starlette.types import Message, Receive, Scope, Send

from service.access.authentication import AuthenticationMiddleware
from service.access.keys import Keys
from service.settings import Settings


async def _refusals(count: int) -> list[int]:
    """Return the seconds after which refused requests may come again, while another one takes the only place."""
    over = asyncio.Event()

    async def wait(_scope: Scope, _receive: Receive, _send: Send) -> None:
        await over.wait()

    settings = Settings(limit_concurrency=2)
    middleware = AuthenticationMiddleware(wait, settings, Keys(settings))
    seconds: list[int] = []

    async def receive() -> Message:
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        if message["type"] == "http.response.start":
            assert message["status"] == 429
            seconds.append(int(dict(message["headers"])[b"retry-after"]))

    def ask() -> asyncio.Task[None]:
        scope = {"type": "http", "method": "GET", "path": "/v1/fits", "headers": [], "client": ("127.0.0.1", 1)}
        return asyncio.create_task(middleware(scope, receive, send))

    first = ask()
    await asyncio.gather(*(ask() for _ in range(count)))
    over.set()
    await first
    return seconds


def test_refused_requests_of_one_caller_are_asked_to_come_one_after_the_other_within_a_minute() -> None:
    seconds = asyncio.run(_refusals(2000))
    assert len(seconds) == 2000
    assert seconds == sorted(seconds)
    assert (seconds[0], seconds[-1]) == (1, 60)
    assert 19 <= seconds[399] <= 20  # twenty a second
