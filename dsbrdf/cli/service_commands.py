"""Commands of the HTTP service: their flags and their help are the service's own."""

import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

from dsbrdf.extras import require

# command -> (modules that it needs, what it does)
SERVICE_COMMANDS = {
    "serve": (("fastapi", "pydantic_settings", "uvicorn"), "Run the HTTP service."),
    "keys": (("pydantic_settings",), "Add, list and revoke API keys of the service."),
    "purge": (("pydantic_settings",), "Remove old fits and measurements of the service."),
    "doctor": (("pydantic_settings",), "Check the service's database and stored files."),
}


def run_service_command(command: str, words: Sequence[str]) -> int:
    """Run one of `SERVICE_COMMANDS` with the arguments that follow it; return the exit code.

    Raises
    ------
    MissingExtraError
        If the service is not installed.
    """
    needed, _ = SERVICE_COMMANDS[command]
    require("service", *needed, purpose="the HTTP service" if command == "serve" else f"dsbrdf {command}")
    if command == "serve":  # replaces this process, so that signals reach the service
        sys.stdout.flush()
        os.execv(sys.executable, [sys.executable, "-m", "service", *words])  # noqa: S606 (no shell)
    main: Callable[[Sequence[str]], int] = import_module(f"service.commands.{command}").main
    return main(words)
