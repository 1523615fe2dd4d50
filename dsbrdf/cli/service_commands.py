"""Commands on the data folder of a service: each is a module of `service`, which gets the words of the command line."""

import argparse
import os
import sys
from typing import Any

from dsbrdf.extras import require

# command -> (module of the service, modules that it cannot do without, what it does)
_COMMANDS = {
    "keys": ("service.commands.keys", ("pydantic_settings",), "add, list and revoke API keys of the service"),
    "purge": ("service.commands.purge", ("pydantic_settings",), "remove old fits and measurements of the service"),
    "doctor": ("service.commands.doctor", ("pydantic_settings",), "look for what is wrong with the service's folder"),
}


def add_service_commands(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the commands to those of ``dsbrdf``; their flags and their help are the service's."""
    for name, (_, _, purpose) in _COMMANDS.items():
        # With a character that no word begins with for flags, every word is left as it is.
        command = commands.add_parser(name, help=purpose, add_help=False, prefix_chars="\0")
        command.add_argument("words", nargs=argparse.REMAINDER)
        command.set_defaults(run=_run, command=name)


def _run(arguments: argparse.Namespace) -> int:
    module, needed, _ = _COMMANDS[arguments.command]
    require("service", *needed, purpose=f"dsbrdf {arguments.command}")
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", module, *arguments.words])  # noqa: S606 (takes our place)
