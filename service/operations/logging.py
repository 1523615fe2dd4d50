"""The service's log: every line of this process, whoever writes it, in one form on stderr.

JSON lines, or text for a person at a terminal. A line carries the id of the request that caused it, and what was
bound besides (structlog's context variables), also in the tasks and threads that the request has started. Keys
never reach it: whatever looks like one is cut out of every line. A line stays one line, whatever a client sends.
"""

import logging
import math
import re
import sys
import time
from typing import Any

import structlog
from structlog.processors import JSONRenderer, TimeStamper, add_log_level, format_exc_info
from structlog.stdlib import ExtraAdder, ProcessorFormatter, add_logger_name
from structlog.typing import EventDict, Processor

from service.settings import Settings

_SECRETS = re.compile(r"(\bdsbrdf_[A-Za-z0-9]+_)[\w-]{8,}|(?i:(\b(?:bearer|basic)\s+)[\w.~+/=-]{8,})")
# Characters that would end a line or control a terminal.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")
_CONTROLS_BUT_NEWLINE = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u2028\u2029]")
_OUT_OF_DESCRIPTORS = "socket.accept() out of system resource"
_SECONDS_BETWEEN = 10.0


def configure(settings: Settings) -> None:
    """Send everything that is logged or warned of in this process to stderr, as `settings` say."""
    text = settings.log_format == "text" or (settings.log_format == "auto" and sys.stderr.isatty())
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter(text=text, colors=text and sys.stderr.isatty()))
    handler.addFilter(_Repetitions())
    logging.basicConfig(handlers=[handler], level=settings.log_level.upper(), force=True)
    logging.captureWarnings(capture=True)


def formatter(*, text: bool, colors: bool = False) -> logging.Formatter:
    """Return what makes a line of a log record: JSON, or text for a person."""
    gather: list[Processor] = [
        TimeStamper(fmt="iso", utc=True, key="time"),
        add_log_level,
        add_logger_name,
        structlog.contextvars.merge_contextvars,
        ExtraAdder(),
        format_exc_info,
        _with_traceback_of_child,
    ]
    if text:
        console = structlog.dev.ConsoleRenderer(colors=colors, timestamp_key="time", pad_event_to=0)
        render: list[Processor] = [_on_one_line, console]
    else:
        render = [_in_order, JSONRenderer(default=str)]
    processors = [ProcessorFormatter.remove_processors_meta, *render, _without_secrets]
    return ProcessorFormatter(foreign_pre_chain=gather, processors=processors)


class _Repetitions:
    """Filter that limits the event loop's message about missing descriptors, of which it sends thousands a second."""

    def __init__(self) -> None:
        self._told = -math.inf

    def filter(self, record: logging.LogRecord) -> bool:
        if record.name != "asyncio" or not record.msg.startswith(_OUT_OF_DESCRIPTORS):
            return True
        now = time.monotonic()
        if now - self._told < _SECONDS_BETWEEN:
            return False
        self._told = now
        return True


def _with_traceback_of_child(_: Any, __: str, event: EventDict) -> EventDict:
    """Add the traceback of a record that came from another process as text."""
    event.pop("color_message", None)  # uvicorn's copy of the message with colours
    text = event["_record"].exc_text
    if text and "exception" not in event:
        event["exception"] = text
    return event


def _in_order(_: Any, __: str, event: EventDict) -> EventDict:
    """Put first what every line has."""
    first = {name: event.pop(name) for name in ("time", "level", "event")}
    return {**first, **event}


def _on_one_line(_: Any, __: str, event: EventDict) -> EventDict:
    """Escape control characters; a traceback keeps its lines, indented so that none looks like one of the log."""
    for name, value in event.items():
        if name == "exception":
            escaped = _CONTROLS_BUT_NEWLINE.sub(_escape, str(value))
            event[name] = "    " + escaped.replace("\n", "\n    ")
        elif not isinstance(value, (int, float, type(None))):
            event[name] = _CONTROLS.sub(_escape, str(value))
    return event


def _escape(match: re.Match[str]) -> str:
    return match.group().encode("unicode_escape").decode()


def _without_secrets(_: Any, __: str, line: Any) -> str:
    return _SECRETS.sub(lambda match: f"{match[1] or match[2]}...", line)
