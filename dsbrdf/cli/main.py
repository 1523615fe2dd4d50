"""The command ``dsbrdf``.

Angles are in degrees on the command line, BRDF values in 1/sr, colours in the order red, green, blue.  Exit codes:
0 success; 2 bad usage or bad input, with one sentence on stderr; 130 interrupted; 1 any other failure.

The module of a command is imported when the command is called, so that commands which compute nothing answer at once.
"""

import os
import sys
from collections.abc import Callable, Collection, Sequence
from importlib import import_module

from dsbrdf.cli.arguments import BAD_INPUT, Parser, did_you_mean, print_error, split_points
from dsbrdf.cli.service_commands import SERVICE_COMMANDS, run_service_command
from dsbrdf.errors import WRONG_PATH_ERRORS, DSBRDFError
from dsbrdf.extras import MissingExtraError
from dsbrdf.process_settings import ONE_BLAS_THREAD
from dsbrdf.version import __version__

INTERRUPTED = 130

# command -> (module whose function ``configure`` completes its parser, what the command does)
_COMMANDS = {
    "fit": ("dsbrdf.cli.fit_command", "fit models to measurements"),
    "eval": ("dsbrdf.cli.model_commands", "print values of a model"),
    "show": ("dsbrdf.cli.model_commands", "print the report of a fit again"),
    "decompose": ("dsbrdf.cli.model_commands", "print the specular spike, specular lobe and diffuse part"),
    "export": ("dsbrdf.cli.model_commands", "write a model for other programs"),
    "plot": ("dsbrdf.cli.plot_command", "draw the fit of a measurement, or the parameters of a model"),
    "compare": ("dsbrdf.cli.compare_command", "compare two models or measurements, with their spheres side by side"),
    "schema": ("dsbrdf.cli.schema_command", "print the JSON Schema of stored models"),
    "render": ("dsbrdf.cli.render_command", "draw a lit sphere of a model or a measurement"),
    "convert": ("dsbrdf.cli.convert_command", "write a measurement as another kind of file"),
    "completion": ("dsbrdf.cli.completion_command", "print what makes a shell complete commands, options and files"),
    "paper": ("dsbrdf.cli.paper_command", "make the figures of Nishino 2009 from a folder of measurements"),
    "demo": ("dsbrdf.cli.demo", "start the service, fit a generated measurement, save a figure"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments after ``dsbrdf``; by default those of the process.

    Returns
    -------
    int
        The exit code.
    """
    try:
        code = _run(list(sys.argv[1:] if argv is None else argv))
        sys.stdout.flush()
    except (DSBRDFError, *WRONG_PATH_ERRORS) as error:
        print_error(error)
        return BAD_INPUT
    except BrokenPipeError:
        # The program that reads our output has ended, as `head` does; the interpreter must not flush at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (MissingExtraError, OSError) as error:
        print_error(error)
        return 1
    except KeyboardInterrupt:
        print_error("interrupted")
        return INTERRUPTED
    return code


def command_names() -> tuple[str, ...]:
    """Return the names of the commands that have their arguments here, not in the service."""
    return tuple(_COMMANDS)


def parsers(configured: Collection[str]) -> tuple[Parser, dict[str, Parser]]:
    """Return the parser of the whole command line and those of its commands; only `configured` have their arguments."""
    parser = Parser(prog="dsbrdf", description="Directional Statistics BRDF models of measured reflectance.")
    parser.add_argument("--version", action="version", version=f"dsbrdf {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    of_commands = {name: commands.add_parser(name, help=purpose) for name, (_, purpose) in _COMMANDS.items()}
    for name in configured:
        import_module(_COMMANDS[name][0]).configure(of_commands[name], name)
    for name, (_, purpose) in SERVICE_COMMANDS.items():
        commands.add_parser(name, help=purpose)
    return parser, of_commands


def _run(words: list[str]) -> int:
    command = words[0] if words else ""
    if command in SERVICE_COMMANDS:
        return run_service_command(command, words[1:])
    if command in ("fit", "paper") and "numpy" not in sys.modules:  # NumPy reads these variables when it is imported
        os.environ.update(ONE_BLAS_THREAD)
    parser, of_commands = parsers({command} & {*_COMMANDS})
    if command not in of_commands:
        if not command.startswith("-"):
            known = (*_COMMANDS, *SERVICE_COMMANDS)
            parser.error(
                f"there is no command {command!r}{did_you_mean(command, known)}" if command else "name a command"
            )
        parser.parse_args(words)
        parser.error("name a command")
    arguments = of_commands[command].parse_intermixed_args(split_points(words[1:]))
    run: Callable[..., int] = arguments.run
    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
