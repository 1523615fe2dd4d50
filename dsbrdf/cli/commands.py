"""Define the commands of ``dsbrdf`` for cyclopts, which reads the command line and writes the help.

The extra ``cli`` installs cyclopts. The module of a command is imported when the command is called.
"""

import shutil
import sys
from collections.abc import Sequence
from datetime import timedelta
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from cyclopts import (
    App,
    CoercionError,
    CycloptsError,
    Group,
    MissingArgumentError,
    Parameter,
    RepeatArgumentError,
    Token,
    UnknownOptionError,
    UnusedCliTokensError,
    ValidationError,
    convert,
)
from cyclopts.help import DefaultFormatter, PanelSpec
from rich.box import Box
from rich.console import Console

from dsbrdf.cli.arguments import BAD_INPUT, SERVICE_COMMANDS, did_you_mean, join_points, print_error
from dsbrdf.version import __version__


def _whole_number(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert a whole number; refuse a number such as 2.5, which cyclopts would round."""
    (token,) = tokens
    if "." in token.value:
        raise CoercionError(token=token, target_type=kind)
    return convert(kind, tokens)


Whole = Parameter(converter=_whole_number, metavar="N")

_MAX_HELP_COLUMNS = 100
_NO_LINES = Box("    \n" * 8)

# The commands by group: the module and function that run each, and its sentence in the help.
_COMMANDS = {
    "Models": {
        "fit": ("fit_command:fit", "Fit models to measurements."),
        "show": ("model_commands:show", "Print the report of a stored fit."),
        "eval": ("model_commands:evaluate", "Print values of a model."),
        "materials": ("model_commands:print_materials", "List measured materials whose fits come with the package."),
        "decompose": ("model_commands:print_components", "Print the specular spike, specular lobe and diffuse part."),
    },
    "Pictures": {
        "plot": (
            "picture_commands:plot",
            "Draw a measurement, its fit, the parameters of a model, or several materials.",
        ),
        "render": ("picture_commands:render", "Draw a lit sphere of a model or a measurement."),
        "map": ("picture_commands:map_materials", "Draw a map on which similar materials lie near each other."),
        "compare": ("compare_command:compare", "Compare models or measurements, with their spheres side by side."),
    },
    "Files": {
        "export": ("model_commands:export", "Write a model for other programs."),
        "table": ("table_command:table", "Print how a table of samples is understood."),
        "convert": ("model_commands:convert", "Write a measurement as another kind of file."),
    },
    "More": {
        "completion": ("commands:completion", "Print the script with which a shell completes commands."),
    },
}


def command_names() -> list[str]:
    """Return the names of the commands, without the commands of the service."""
    return [name for commands in _COMMANDS.values() for name in commands]


def new_application(name: str, purpose: str) -> App:
    """Return an application without commands, for `run_words`."""
    options = Group("Options", sort_key=1)
    app = App(
        name=name,
        help=purpose,
        version=f"dsbrdf {__version__}",
        group_parameters=options,
        default_parameter=Parameter(
            negative=(), show_default=lambda default: None if default in (None, False, ()) else str(default)
        ),
        help_formatter=DefaultFormatter(panel_spec=PanelSpec(box=_NO_LINES, border_style="bold", padding=(0, 0, 0, 4))),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        suppress_keyboard_interrupt=False,
    )
    for flag in ("--help", "--version"):
        app[flag].group = (options,)
    return app


def application() -> App:
    """Return the application with all commands; the help only lists the commands of the service."""
    app = new_application("dsbrdf", "Directional Statistics BRDF models of measured reflectance.")
    for heading, commands in _COMMANDS.items():
        group = Group.create_ordered(heading)
        for name, (function, purpose) in commands.items():
            app.command(f"dsbrdf.cli.{function}", name=name, help=purpose, group=group)
    group = Group.create_ordered("Service")
    for name, (_, purpose) in SERVICE_COMMANDS.items():
        app.command(App(name=name, help=purpose, group=group))
    group = Group.create_ordered("Options")
    for flag in ("--help", "--version"):
        app[flag].group = (group,)
    return app


def run_command(words: Sequence[str]) -> int:
    """Run a command with its arguments, or print its help; return the exit code."""
    app = application()
    if words[0] not in app:
        what = f"option {words[0]!r} before the command" if words[0].startswith("-") else f"command {words[0]!r}"
        print_error(f"there is no {what}{did_you_mean(words[0], app)} (see dsbrdf --help)")
        return BAD_INPUT
    if not all(words):  # An empty path would be the current folder.
        print_error(f"an argument is empty, as of a variable without a value (see dsbrdf {words[0]} --help)")
        return BAD_INPUT
    return run_words(app, join_points(words))


def run_words(app: App, words: Sequence[str]) -> int:
    """Run an application with arguments, report wrong arguments in one sentence, and return the exit code."""
    width = min(shutil.get_terminal_size().columns, _MAX_HELP_COLUMNS)
    try:
        code: int | None = app(words, console=Console(width=width))
    except CycloptsError as error:
        command = " ".join([*app.name, *(error.command_chain or ())])
        sys.stderr.write(f"{command}: {_reason(error).removesuffix('.')} (see {command} --help)\n")
        return BAD_INPUT
    return code or 0


def _reason(error: CycloptsError) -> str:
    if isinstance(error, UnknownOptionError):
        name = error.token.keyword or error.token.value
        known = [name for argument in error.argument_collection for name in argument.names]
        return f"there is no option {name}{did_you_mean(name, known)}"
    if isinstance(error, UnusedCliTokensError):
        return f"there is no place for {' '.join(error.unused_tokens or ())}"
    if isinstance(error, RepeatArgumentError):
        return f"{error.token.keyword} is given more than once"
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        return f"{error.keyword} needs a value" if error.keyword else f"{error.argument.name} is missing"
    if isinstance(error, ValidationError) and error.argument is not None:
        return f"{error.argument.name}: {error.exception_message}"
    if isinstance(error, CoercionError) and error.token is not None and error.msg is None:
        name = error.token.keyword or (error.argument.name if error.argument else "")
        return f"{name}: must be {_allowed(error.target_type)}, not {error.token.value!r}"
    return str(error)


def _allowed(kind: Any) -> str:
    """Return a phrase for the values of a type, such as "a whole number or auto"."""
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(_allowed(member) for member in get_args(kind))
    if get_origin(kind) is Literal:
        return " or ".join(get_args(kind))
    if get_origin(kind) is tuple:  # The first type stands for all, because every tuple here has members of one type.
        return _allowed(get_args(kind)[0])
    words = {int: "a whole number", float: "a number", bool: "yes or no", timedelta: "a time such as 30d"}
    return "none" if kind is NoneType else words.get(kind, "a text")


def completion(shell: Literal["bash", "zsh", "fish"], /) -> None:
    """Print the script with which a shell completes commands, options and files.

    Parameters
    ----------
    shell
        Load the script with: eval "$(dsbrdf completion bash)"; in fish with: dsbrdf completion fish | source
    """
    print(application().generate_completion(shell=shell))  # nosec B604
