"""``python -m service``: run the HTTP service."""

import argparse
import shutil
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import uvicorn
from pydantic import ValidationError

from service.app import create_app
from service.migrations import DataFolderError
from service.problems import sentence
from service.settings import Settings
from service.store import Store

_LONGEST_SOCKET_FOLDER = 75  # a socket's path has at most 107 characters, of which multiprocessing takes 32


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the service until it is stopped; return the exit code."""
    try:
        settings = _settings(arguments)
    except ValidationError as error:
        return _refuse(sentence(error.errors()))
    if not settings.loopback and not settings.insecure:
        return _refuse(
            f"{settings.host} can be reached from other machines and no API keys are set: "
            "listen on 127.0.0.1, or add --insecure to let everyone in."
        )
    try:
        Store(settings.data_dir).close()
    except (DataFolderError, OSError) as error:
        return _refuse(str(error))
    config = uvicorn.Config(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        log_level=settings.log_level,
        limit_concurrency=settings.limit_concurrency,
        timeout_graceful_shutdown=settings.shutdown_seconds,
        server_header=False,
        ws="none",
        access_log=settings.access_log,
    )
    server = uvicorn.Server(config)
    # When it has shut down, uvicorn raises the signal that stopped it once more: an ordinary exit then.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    _keep_temporary_files_in(settings.data_dir)
    try:
        server.run()
    except KeyboardInterrupt:
        return 0
    return 0 if server.started else 1


def _settings(arguments: Sequence[str] | None) -> Settings:
    parser = argparse.ArgumentParser(
        prog="python -m service",
        description="Run the HTTP service. Further settings are environment variables that begin with DSBRDF_.",
    )
    parser.add_argument("--host", help="address to listen on (default 127.0.0.1)")
    parser.add_argument("--port", type=int, help="port to listen on, 0 for a free one (default 8000)")
    parser.add_argument("--data-dir", help="folder of the database and the measurements (default dsbrdf-data)")
    parser.add_argument("--workers", type=int, help="fits that run at once (default: one for each core)")
    parser.add_argument(
        "--insecure", action="store_true", default=None, help="allow an address other than loopback without API keys"
    )
    given: dict[str, Any] = {
        name: value for name, value in vars(parser.parse_args(arguments)).items() if value is not None
    }
    return Settings(**given)


def _keep_temporary_files_in(data_dir: Path) -> None:
    """Let the fork server have its socket where the next start removes what a killed server has left."""
    folder = data_dir.resolve() / "run"
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir()
    if len(str(folder)) <= _LONGEST_SOCKET_FOLDER:
        tempfile.tempdir = str(folder)


def _refuse(reason: str) -> int:
    sys.stderr.write(f"dsbrdf: {reason}\n")
    return 2


if __name__ == "__main__":
    sys.exit(main())
