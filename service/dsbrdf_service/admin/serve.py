"""Define ``dsbrdf serve``, which runs the HTTP service, with some of the settings as flags."""

import asyncio
import errno
import faulthandler
import logging
import os
import resource
import signal
import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Annotated, Any, cast

import uvicorn
from cyclopts import Parameter
from fastapi import FastAPI
from pydantic import ValidationError

from dsbrdf.cli.arguments import prepare_output, print_error
from dsbrdf.cli.commands import new_application, run_words
from dsbrdf.extras import MissingExtraError
from dsbrdf.process_settings import return_freed_memory, trim_memory

from ..api.context import Context
from ..app import create_app, make_engine
from ..errors import DataFolderError, validation_sentence
from ..http.middleware import Connection
from ..log import configure
from ..settings import Settings
from ..storage.keys import has_active_key
from ..storage.store import Store
from .commands import refuse

# More connections than requests are allowed, because most connections are idle; beyond this limit, requests get 503.
_CONNECTIONS_PER_REQUEST = 8
_BACKLOG = 128  # asyncio tries so many accepts at once, and reports each that fails.
_CLEANUP_TIMEOUT_S = 5.0  # The process ends if its queue, processes and database are not closed within this time.
_INTERPRETER_EXIT_TIMEOUT_S = 60.0  # The process ends this long after the server, even if a thread hangs.

logger = logging.getLogger(__name__)
_PURPOSE = "Run the HTTP service. Further settings are environment variables that begin with DSBRDF_."


def _flag(name: str) -> Parameter:
    setting = Settings.model_fields[name]
    default = "one for each core" if name == "workers" else setting.default
    return Parameter(help=f"{setting.description}{f' Default: {default}.' if default else ''}", metavar=name.upper())


def serve(
    *,
    host: Annotated[str | None, _flag("host")] = None,
    port: Annotated[str | None, _flag("port")] = None,
    data_dir: Annotated[str | None, _flag("data_dir")] = None,
    workers: Annotated[str | None, _flag("workers")] = None,
    insecure: Annotated[bool | None, _flag("insecure")] = None,
) -> int:
    """Run the service with the settings that the flags give as texts; return the exit code."""
    given: dict[str, Any] = {name: value for name, value in locals().items() if value is not None}
    try:
        settings = Settings(**given)
    except ValidationError as error:
        faults = []
        for fault in error.errors():  # Each fault names the flag or the environment variable of its setting.
            name = str(fault["loc"][0])
            written = f"--{name.replace('_', '-')}" if name in given else f"DSBRDF_{name.upper()}"
            faults.append({**fault, "loc": (written,)})
        return refuse(validation_sentence(faults))
    try:
        if not (settings.loopback or settings.insecure or has_active_key(settings.data_dir)):
            return refuse(
                f"{settings.host} can be reached from other machines and there is no API key: add one with "
                "dsbrdf keys add NAME, listen on 127.0.0.1, or add --insecure to let everyone in."
            )
        make_engine(settings)  # If a library is missing, this fails before the data folder is opened.
        store = Store(settings.data_dir)  # This locks the folder, so that no other server can open it.
    except (DataFolderError, MissingExtraError) as error:
        return refuse(str(error))
    except OSError as error:
        return refuse(f"{settings.data_dir} cannot be the data folder: {error.strerror or error}.")
    try:
        _check_address(settings.host, settings.port)
    except OSError as error:
        store.close()
        print_error(f"cannot listen on port {settings.port} of {settings.host}: {error.strerror or error}.")
        return 1
    store.keep_temporary_files()
    configure(settings)
    return_freed_memory()
    # The usual limit of open files is below the number of connections.
    _, maximum = resource.getrlimit(resource.RLIMIT_NOFILE)
    with suppress(OSError, ValueError):  # Some systems report more open files than they allow.
        resource.setrlimit(resource.RLIMIT_NOFILE, (maximum, maximum))
    return _run(settings, store)


def main(words: Sequence[str] | None = None) -> int:
    """Run the command with its arguments until the service is stopped; return the exit code."""
    prepare_output()
    app = new_application("dsbrdf serve", _PURPOSE)
    app.default(serve)
    return run_words(app, sys.argv[1:] if words is None else words)


def _run(settings: Settings, store: Store) -> int:
    app = create_app(settings, store)
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        http=Connection,
        limit_concurrency=_CONNECTIONS_PER_REQUEST * settings.limit_concurrency,
        timeout_graceful_shutdown=settings.shutdown_seconds,
        server_header=False,
        # X-Forwarded-For is trusted only if the operator names the proxies, because any client can send this header.
        proxy_headers="FORWARDED_ALLOW_IPS" in os.environ,
        ws="none",
        backlog=_BACKLOG,
        log_config=None,
        log_level=settings.log_level,
        access_log=False,
        callback_notify=partial(asyncio.to_thread, trim_memory),  # Requests run in other threads, which stay free.
        timeout_notify=60,
    )
    server = _Server(config)
    logger.info("dsbrdf %s serves the data folder %s", app.version, settings.data_dir.resolve())
    server.run()
    # This replaces the shorter timeout of the shutdown, because the interpreter may take seconds to exit.
    faulthandler.dump_traceback_later(_INTERPRETER_EXIT_TIMEOUT_S, exit=True)
    return 0 if server.started else 1


class _Server(uvicorn.Server):
    """Run uvicorn's server; at shutdown, first answer the requests that wait for fits."""

    _next_report_at = 0.0

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Begin the shutdown at the first signal; further signals do not interrupt it."""

        def end(*_: object) -> None:
            self.should_exit = True

        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            if signal.getsignal(number) != signal.SIG_IGN:  # SIGHUP, for example, stays ignored under nohup.
                signal.signal(number, end)
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the server, and print its address if stdout is a terminal."""
        asyncio.get_running_loop().set_exception_handler(self._report)
        await super().startup(sockets)
        if self.started and sys.stdout.isatty():
            host, port = self.servers[0].sockets[0].getsockname()[:2]
            print(
                f"dsbrdf serves at http://{f'[{host}]' if ':' in host else host}:{port}; Ctrl-C stops it.", flush=True
            )

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop accepting requests, and let the requests in progress end soon."""
        if sys.stdout.isatty():
            print(flush=True)  # The terminal has written ^C, after which the next prompt begins a line of its own.
        context: Context = cast(FastAPI, self.config.app).state.context
        # If the shutdown hangs, the process ends anyway, because accepted fits are stored and the next start runs them.
        faulthandler.dump_traceback_later(context.settings.shutdown_seconds + _CLEANUP_TIMEOUT_S, exit=True)
        context.readiness.stop()
        context.queue.release_waiters()
        await super().shutdown(sockets)

    def _report(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Log an error of the event loop, at most one each second if too many files are open for a new connection."""
        error = context.get("exception")
        if not isinstance(error, OSError) or error.errno not in (errno.EMFILE, errno.ENFILE):
            loop.default_exception_handler(context)
        elif loop.time() >= self._next_report_at:
            self._next_report_at = loop.time() + 1.0
            logger.error("no connection can be accepted: %s", error.strerror)


def _check_address(host: str, port: int) -> None:
    """Raise OSError unless the service could listen on the address."""
    for family, kind, protocol, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        with socket.socket(family, kind, protocol) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                trial.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            trial.bind(address)
