"""How many requests a second: a token bucket."""

from time import monotonic

_BURST_SECONDS = 5.0


class Bucket:
    """Holds the requests that may come at once, and fills again at a steady rate.

    Parameters
    ----------
    rate : float
        Requests per second; as many as five seconds give may come at once, and one at least.
    """

    __slots__ = ("_filled", "_last", "_size", "rate")

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self._size = max(1.0, rate * _BURST_SECONDS)
        self._filled = self._size
        self._last = monotonic()

    def take(self) -> float:
        """Take one request out; return 0, or the time until there is one [s]."""
        now = monotonic()
        self._filled = min(self._size, self._filled + (now - self._last) * self.rate)
        self._last = now
        if self._filled >= 1.0:
            self._filled -= 1.0
            return 0.0
        return (1.0 - self._filled) / self.rate
