"""The command ``dsbrdf completion``: a script with which a shell completes commands, options and files."""

import argparse
from pathlib import Path

from dsbrdf.extras import require

SHELLS = ("bash", "zsh", "tcsh")


def configure(parser: argparse.ArgumentParser, _: str) -> None:
    """Add the arguments of the command to its parser."""
    parser.set_defaults(run=_completion)
    parser.description = 'Load the script with: eval "$(dsbrdf completion bash)"'
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))


def _completion(arguments: argparse.Namespace) -> int:
    require("cli", "shtab", purpose="completion")
    import shtab

    from dsbrdf.cli.main import command_names, parsers

    parser, of_commands = parsers(command_names())
    for command in of_commands.values():
        for action in command._actions:  # argparse offers no other way to them
            if action.type is Path:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    print(shtab.complete(parser, arguments.shell))
    return 0
