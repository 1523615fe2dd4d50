"""Write the log of this process to stderr, as lines of JSON, or as plain text if stderr is a terminal.

A line contains the id of its request and other values of `bind`, also in tasks and threads that the request started.
Texts that look like keys are removed from every line, and long texts are truncated.
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
# A line leaves out these attributes, which every record has, and shows all others, which were passed as `extra`.
_NOT_SHOWN = frozenset((*vars(logging.makeLogRecord({})), "message", "asctime", "color_message"))
_MAX_VALUE_LENGTH = 500  # [characters] Longer values in a line are truncated.
_MAX_TRACEBACK_LENGTH = 20_000  # [characters] Longer tracebacks are truncated.
_bound: ContextVar[Mapping[str, str]] = ContextVar("bound", default=MappingProxyType({}))
_MAX_QUEUED_LINES = 2000  # Further lines are dropped and counted until lines have been written.
_FLUSH_TIMEOUT_S = 1.0


def bind(name: str, value: str) -> None:
    """Add a value to all further lines that this task logs, and that tasks and threads started by it log."""
    _bound.set({**_bound.get(), name: value})


def configure(settings: Settings) -> None:
    """Write log lines and warnings of this process to stderr, at or above the level in the settings."""
    handler = LogWriter(sys.stderr.fileno())
    logging.basicConfig(handlers=[handler], level=settings.log_level.upper(), force=True)
    handler.setFormatter(LineFormatter(in_words=sys.stderr.isatty()))
    logging.captureWarnings(capture=True)


class LogWriter(logging.Handler):
    """Write lines in a separate thread, so that logging never waits for a slow reader of the log.

    When the queue is full, lines are dropped and counted, and the count is logged. The thread writes to the file
    descriptor, because a blocked write to a Python stream would hold the lock of the stream.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._lines: Queue[str] = Queue(_MAX_QUEUED_LINES)
        self._n_dropped = 0
        Thread(target=self._write_lines, name="log", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Put the line of a record in the queue, or count the line as dropped."""
        try:
            self._lines.put_nowait(self.format(record))
        except Full:
            self._n_dropped += 1

    def flush(self) -> None:
        """Wait at most a second for the queued lines to be written."""
        end = time.monotonic() + _FLUSH_TIMEOUT_S
        while self._lines.unfinished_tasks and time.monotonic() < end:
            time.sleep(0.01)

    def _write_lines(self) -> None:
        n_reported = 0
        while True:
            lines, n_dropped = [self._lines.get()], self._n_dropped
            if n_dropped > n_reported:
                report = f"{n_dropped - n_reported} lines of the log were dropped: nobody read it."
                about = {"name": __name__, "levelname": "WARNING", "msg": report}
                lines.append(self.format(logging.makeLogRecord(about)))
                n_reported = n_dropped
            rest = "".join(f"{line}\n" for line in lines).encode(errors="replace")
            with suppress(OSError):  # If the program that reads the log has ended, lines are lost.
                while rest:
                    rest = rest[os.write(self._descriptor, rest) :]
            self._lines.task_done()


class LineFormatter(logging.Formatter):
    """Format a record as one line: JSON, or plain text that begins with time, level and event."""

    def __init__(self, *, in_words: bool = False) -> None:
        super().__init__()
        self._in_words = in_words

    def format(self, record: logging.LogRecord) -> str:
        """Return a record as one line."""
        line: dict[str, Any] = {
            "time": f"{datetime.fromtimestamp(record.created, UTC):%Y-%m-%dT%H:%M:%S.%fZ}",
            "level": record.levelname.lower(),
            "event": record.getMessage(),
            "logger": record.name,
            **_bound.get(),
        }
        line |= {name: value for name, value in vars(record).items() if name not in _NOT_SHOWN}
        line = {name: _shown(value, _MAX_VALUE_LENGTH) for name, value in line.items()}
        # A record from another process has its traceback as text.
        exception = self.formatException(record.exc_info) if record.exc_info else record.exc_text
        if exception:
            line["exception"] = _shown(exception, _MAX_TRACEBACK_LENGTH)
        if not self._in_words:
            return json.dumps(line)
        texts = {name: json.dumps(str(value))[1:-1] for name, value in line.items()}  # JSON escapes line breaks.
        first = [texts.pop(name) for name in ("time", "level", "event")]
        return " ".join([*first, *(f"{name}={text}" for name, text in texts.items())])


def _shown(value: Any, max_length: int) -> Any:
    """Return a number unchanged, and anything else as a text without keys, truncated to `max_length` characters.

    Keys are removed before the text is truncated, because a part of a key would not be recognised.
    """
    if value is None or isinstance(value, int | float):
        return value
    text = _SECRETS.sub(lambda match: f"{match[1] or match[2]}...", str(value))
    return text if len(text) <= max_length else f"{text[:max_length]}... ({len(text)} characters)"
