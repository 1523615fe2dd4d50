"""The commands of ``dsbrdf`` as an application of cyclopts, which reads the command line and writes the help.

cyclopts belongs to the extra ``cli``.  The module of a command is imported when the command is called.
"""

import shutil
import sys
from collections.abc import Sequence
from typing import Any

from cyclopts import App, CycloptsError, Group, Parameter
from cyclopts.help import DefaultFormatter, PanelSpec
from rich.box import Box
from rich.console import Console

from dsbrdf.cli.arguments import BAD_INPUT, did_you_mean, join_points, print_error
from dsbrdf.cli.service_commands import SERVICE_COMMANDS
from dsbrdf.cli.usage_errors import usage_sentence
from dsbrdf.version import __version__

_WIDTH = 100  # of the help, at most
_NO_LINES = Box("    \n" * 8)

# group -> command -> (module and function, what the command does)
_COMMANDS = {
    "Models": {
        "fit": ("fit_command:fit", "Fit models to measurements."),
        "show": ("model_commands:show", "Print the report of a fit again."),
        "eval": ("model_commands:evaluate", "Print values of a model."),
        "decompose": ("model_commands:print_components", "Print the specular spike, specular lobe and diffuse part."),
    },
    "Pictures": {
        "plot": ("plot_command:plot", "Draw the fit of a measurement, or the parameters of a model."),
        "render": ("render_command:render", "Draw a lit sphere of a model or a measurement."),
        "compare": ("compare_command:compare", "Compare two models or measurements, with their spheres side by side."),
        "paper": ("paper_command:paper", "Make the figures of Nishino 2009 from a folder of measurements."),
    },
    "Files": {
        "export": ("model_commands:export", "Write a model for other programs."),
        "convert": ("convert_command:convert", "Write a measurement as another kind of file."),
    },
    "More": {
        "demo": ("demo:demo", "Start the service, fit a generated measurement, save a figure."),
        "completion": ("completion_command:completion", "Print what makes a shell complete commands and options."),
    },
}


def command_names() -> list[str]:
    """Return the names of the commands that have their arguments here, not in the service."""
    return [name for commands in _COMMANDS.values() for name in commands]


def application() -> App:
    """Return the application with all commands; those of the service are only listed."""
    app = App(
        name="dsbrdf",
        help="Directional Statistics BRDF models of measured reflectance.",
        version=f"dsbrdf {__version__}",
        group_parameters=Group("Options", sort_key=1),
        default_parameter=Parameter(negative=(), show_default=_shown),
        help_formatter=DefaultFormatter(panel_spec=PanelSpec(box=_NO_LINES, border_style="bold", padding=(0, 0, 0, 4))),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        suppress_keyboard_interrupt=False,
    )
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
    """Run the command that `words` name, or print its help; return the exit code."""
    app = application()
    if words[0] not in app:
        what = f"option {words[0]!r} before the command" if words[0].startswith("-") else f"command {words[0]!r}"
        print_error(f"there is no {what}{did_you_mean(words[0], app)} (see dsbrdf --help)")
        return BAD_INPUT
    width = min(shutil.get_terminal_size().columns, _WIDTH)
    try:
        code: int | None = app(join_points(words), console=Console(width=width))
    except CycloptsError as error:
        sys.stderr.write(f"{usage_sentence(error)}\n")
        return BAD_INPUT
    return code or 0


def _shown(default: Any) -> str | None:
    """Return a default value for the help, unless nothing is the default."""
    return None if default in (None, False, ()) else str(default)
