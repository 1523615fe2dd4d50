"""The service's log: every line of this process, whoever writes it, in one form on stderr.

JSON lines, or text for a person at a terminal. A line carries the id of the request that caused it, and what else was
bound, also in the tasks and threads that the request has started. Keys never reach it: whatever looks like one is cut
out of every line. A line stays one line and short, whatever a client sends.
"""

import logging
import os
import re
import sys
import time
from collections.abc import Mapping
from contextlib import nullcontext, suppress
from contextvars import ContextVar
from datetime import UTC, datetime
from json import JSONEncoder
from queue import Full, Queue
from threading import Thread
from types import MappingProxyType
from typing import Any

from ..settings import Settings

_SECRETS = re.compile(r"(dsbrdf_[A-Za-z0-9]+_)[\w-]{8,}|(?i:(\b(?:bearer|basic)\s+)[\w.~+/=-]{8,})")
# What every record has, and uvicorn's copy of the message with colours; all else was given as `extra`.
_NOT_SHOWN = frozenset((*vars(logging.makeLogRecord({})), "message", "asctime", "color_message"))
_LONGEST = 500  # characters of one value in a line
_LONGEST_TRACEBACK = 20_000
_encode = JSONEncoder(default=str).encode
_bound: ContextVar[Mapping[str, str]] = ContextVar("bound", default=MappingProxyType({}))
_MOST_WAITING = 2000  # lines
_LONGEST_FLUSH = 1.0  # seconds


def bind(name: str, value: str) -> None:
    """Add a value to what this task logs from now on, and the tasks and threads that it starts."""
    _bound.set({**_bound.get(), name: value})


def configure(settings: Settings) -> None:
    """Send everything that is logged or warned of in this process to stderr, as `settings` say."""
    text = settings.log_format == "text" or (settings.log_format == "auto" and sys.stderr.isatty())
    handler = LogWriter(sys.stderr.fileno())
    handler.setFormatter(LineFormatter(text=text))
    logging.basicConfig(handlers=[handler], level=settings.log_level.upper(), force=True)
    logging.captureWarnings(capture=True)


class LogWriter(logging.Handler):
    """Hands lines to a thread that writes them to a descriptor, so that who logs never waits for who reads the log.

    Lines for which there is no room are dropped and counted; the count is a line too. The descriptor is used without
    the lock of Python's streams, which a thread that waits forever would keep.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._lines: Queue[str] = Queue(_MOST_WAITING)
        self._n_dropped = 0
        Thread(target=self._write_lines, name="log", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Put a line in the queue."""
        try:
            self._lines.put_nowait(self.format(record))
        except Full:
            self._n_dropped += 1

    def flush(self) -> None:
        """Wait for the lines to be written, for a moment."""
        end = time.monotonic() + _LONGEST_FLUSH
        while self._lines.unfinished_tasks and time.monotonic() < end:
            time.sleep(0.01)

    def _write_lines(self) -> None:
        while True:
            self._write(self._lines.get())
            with self.lock or nullcontext():
                n_dropped, self._n_dropped = self._n_dropped, 0
            if n_dropped:
                told = f"{n_dropped} lines of the log were dropped: nobody read it."
                self._write(self.format(logging.makeLogRecord({"name": __name__, "levelname": "WARNING", "msg": told})))
            self._lines.task_done()

    def _write(self, line: str) -> None:
        rest = f"{line}\n".encode(errors="replace")
        with suppress(OSError):  # nobody can read it any more
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]


class LineFormatter(logging.Formatter):
    """Makes a line of a log record: JSON, or text for a person, in which texts are as in JSON: on one line."""

    def __init__(self, *, text: bool) -> None:
        super().__init__()
        self._text = text

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; as text, a traceback adds lines to it."""
        line: dict[str, Any] = {
            "time": f"{datetime.fromtimestamp(record.created, UTC):%Y-%m-%dT%H:%M:%S.%fZ}",
            "level": record.levelname.lower(),
            "event": record.getMessage(),
            "logger": record.name,
            **_bound.get(),
        }
        line |= {name: value for name, value in vars(record).items() if name not in _NOT_SHOWN}
        line = {name: _cut(value, _LONGEST) for name, value in line.items()}
        # A record that came from another process has its traceback as text.
        exception = self.formatException(record.exc_info) if record.exc_info else record.exc_text
        if exception:
            line["exception"] = _cut(exception, _LONGEST_TRACEBACK)
        return _mask(_in_words(line) if self._text else _encode(line))


def _mask(text: str) -> str:
    return _SECRETS.sub(lambda match: f"{match[1] or match[2]}...", text)


def _cut(value: Any, longest: int) -> Any:
    """Return a text's beginning and its length if it is too long; masked first, as a part of a key does not look it."""
    if not isinstance(value, str) or len(value) <= longest:
        return value
    return f"{_mask(value)[:longest]}... ({len(value)} characters)"


def _in_words(line: dict[str, Any]) -> str:
    """Return time, level and event, and the rest by name; the lines of a traceback follow, indented."""
    texts = {name: _encode(value).strip('"') for name, value in line.items() if name != "exception"}
    first = [f"{texts.pop('time')} {texts.pop('level'):7} {texts.pop('event')}"]
    traceback = [f"    {_encode(part)[1:-1]}" for part in line.get("exception", "").splitlines()]
    return "\n".join([" ".join(first + [f"{name}={value}" for name, value in texts.items()]), *traceback])
