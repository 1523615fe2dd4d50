"""Patience with request bodies: a client may be slow, but it may not hold a place for nothing."""

import asyncio

from starlette.types import Message, Receive

from service.http.problems import ProblemError


class PatientReceive:
    """An ASGI `receive` that gives a body up when it comes too slowly.

    Only time spent waiting for the client counts, none that the service takes itself.

    Parameters
    ----------
    receive : Receive
        The server's own.
    silence_seconds : float
        Time without a byte after which the client is given up [s].
    least_rate : float
        Mean rate that the client has to keep up, after the first `silence_seconds` [bytes/s]; 0 for any.

    Attributes
    ----------
    n_bytes : int
        Bytes received so far.
    """

    def __init__(self, receive: Receive, silence_seconds: float, least_rate: float) -> None:
        self.n_bytes = 0
        self._receive = receive
        self._silence = silence_seconds
        self._least_rate = least_rate
        self._waited = 0.0
        self._ended = False

    async def __call__(self) -> Message:
        """Return the next message; raise ProblemError of the kind ``request-timeout`` if it takes too long."""
        if self._ended:  # what comes now is the end of the connection, and may take its time
            return await self._receive()
        loop = asyncio.get_running_loop()
        begin = loop.time()
        patience = self._silence
        if self._least_rate:
            patience = min(patience, self._silence + self.n_bytes / self._least_rate - self._waited)
        try:
            async with asyncio.timeout(patience):
                message = await self._receive()
        except TimeoutError:
            raise self._too_slow() from None
        self._waited += loop.time() - begin
        self.n_bytes += len(message.get("body", b""))
        self._ended = not message.get("more_body", False)
        return message

    def _too_slow(self) -> ProblemError:
        self._ended = True
        rate = f", or came at less than {self._least_rate:g} bytes a second" if self._least_rate else ""
        detail = f"The body stopped for {self._silence:g} s{rate}; {self.n_bytes} bytes had arrived."
        return ProblemError("request-timeout", detail, {"Connection": "close"})
