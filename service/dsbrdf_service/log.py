"""The service's log: every line of this process, whoever writes it, on stderr: JSON, or words at a terminal.

A line carries the id of the request that caused it, and what else was bound, also in the tasks and threads that the
request has started. Keys never reach it: whatever looks like one is cut out of every text. A line stays short, whatever
a client sends.
"""

import json
import logging
import os
import re
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from contextvars import ContextVar
from datetime import UTC, datetime
from queue import Full, Queue
from threading import Thread
from types import MappingProxyType
from typing import Any

from .settings import Settings

_SECRETS = re.compile(r"(dsbrdf_[A-Za-z0-9]+_)[\w-]{8,}|(?i:(\b(?:bearer|basic)\s+)[\w.~+/=-]{8,})")
# What every record has, and uvicorn's copy of the message with colours; all else was given as `extra`.
_NOT_SHOWN = frozenset((*vars(logging.makeLogRecord({})), "message", "asctime", "color_message"))
_LONGEST = 500  # characters of one value in a line
_LONGEST_TRACEBACK = 20_000
_bound: ContextVar[Mapping[str, str]] = ContextVar("bound", default=MappingProxyType({}))
_MOST_WAITING = 2000  # lines
_LONGEST_FLUSH = 1.0  # seconds


def bind(name: str, value: str) -> None:
    """Add a value to what this task logs from now on, and the tasks and threads that it starts."""
    _bound.set({**_bound.get(), name: value})


def configure(settings: Settings) -> None:
    """Send everything that is logged or warned of in this process to stderr, from the level of the settings on."""
    handler = LogWriter(sys.stderr.fileno())
    logging.basicConfig(handlers=[handler], level=settings.log_level.upper(), force=True)
    handler.setFormatter(LineFormatter(in_words=sys.stderr.isatty()))
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
        n_told = 0
        while True:
            lines, n_dropped = [self._lines.get()], self._n_dropped
            if n_dropped > n_told:
                told = f"{n_dropped - n_told} lines of the log were dropped: nobody read it."
                about = {"name": __name__, "levelname": "WARNING", "msg": told}
                lines.append(self.format(logging.makeLogRecord(about)))
                n_told = n_dropped
            rest = "".join(f"{line}\n" for line in lines).encode(errors="replace")
            with suppress(OSError):  # nobody can read it any more
                while rest:
                    rest = rest[os.write(self._descriptor, rest) :]
            self._lines.task_done()


class LineFormatter(logging.Formatter):
    """Makes a line of a log record: JSON, or words, first when and what happened, then the rest by name."""

    def __init__(self, *, in_words: bool = False) -> None:
        super().__init__()
        self._in_words = in_words

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line: dict[str, Any] = {
            "time": f"{datetime.fromtimestamp(record.created, UTC):%Y-%m-%dT%H:%M:%S.%fZ}",
            "level": record.levelname.lower(),
            "event": record.getMessage(),
            "logger": record.name,
            **_bound.get(),
        }
        line |= {name: value for name, value in vars(record).items() if name not in _NOT_SHOWN}
        line = {name: _shown(value, _LONGEST) for name, value in line.items()}
        # A record that came from another process has its traceback as text.
        exception = self.formatException(record.exc_info) if record.exc_info else record.exc_text
        if exception:
            line["exception"] = _shown(exception, _LONGEST_TRACEBACK)
        if not self._in_words:
            return json.dumps(line)
        texts = {name: json.dumps(value).strip('"') for name, value in line.items()}  # on one line, as in JSON
        first = [texts.pop(name) for name in ("time", "level", "event")]
        return " ".join([*first, *(f"{name}={text}" for name, text in texts.items())])


def _shown(value: Any, longest: int) -> Any:
    """Return a number as it is, and anything else as a text without keys; of a long text, the beginning and the length.

    Keys are cut out first: a part of one does not look like a key.
    """
    if value is None or isinstance(value, int | float):
        return value
    text = _SECRETS.sub(lambda match: f"{match[1] or match[2]}...", str(value))
    return text if len(text) <= longest else f"{text[:longest]}... ({len(text)} characters)"
