import inspect
import re
from dataclasses import fields

import numpy as np
from cyclopts import App

import dsbrdf
from dsbrdf.cli.parameters import DEFAULT, Flags
from tests.support.command_line import printed

# options of the fit


def options_of(*words: str) -> dsbrdf.FitOptions:
    def command(*, flags: Flags = DEFAULT) -> dsbrdf.FitOptions:
        return flags.options()

    options: dsbrdf.FitOptions = App(default_command=command, result_action="return_value")(words)
    return options


def descriptions() -> dict[str, str]:
    """What the docstring of the options says of each field."""
    text = inspect.getdoc(dsbrdf.FitOptions) or ""
    entries = re.findall(r"^(\w+) : .*\n((?:    .+(?:\n|$))+)", text, flags=re.MULTILINE)
    assert {name for name, _ in entries} == {field.name for field in fields(dsbrdf.FitOptions)}
    return {name: " ".join(text.split()) for name, text in entries}


def test_every_option_has_a_flag_with_help() -> None:
    text = " ".join(printed("fit", "--help").split())
    for name, description in descriptions().items():
        assert f" --{name.replace('_', '-')} " in text
        assert " ".join(description.split()[:4]) in text
    assert "[rad]" not in text
    assert "[default: 80]" in text


def test_every_angle_option_is_converted_from_degrees() -> None:
    given = {"horizon_cutoff": "10", "knots": "10,20"}
    assert {name for name, text in descriptions().items() if "[rad]" in text} == given.keys()
    words = [f"--{name.replace('_', '-')}={degrees}" for name, degrees in given.items()]
    assert options_of(*words) == dsbrdf.FitOptions(
        horizon_cutoff=float(np.radians(10.0)), knots=(float(np.radians(10.0)), float(np.radians(20.0)))
    )
    assert options_of("--knots", "none", "--horizon-cutoff", "none") == dsbrdf.FitOptions(horizon_cutoff=None)


def test_flags_reach_the_options() -> None:
    words = ["--n-lobes", "2", "--weighting", "log", "--robust", "--mask", "0.5", "--horizon-cutoff", "75"]
    asked = dsbrdf.FitOptions(n_lobes=2, weighting="log", robust=True, mask=0.5, horizon_cutoff=float(np.radians(75)))
    assert options_of(*words) == asked
    assert options_of("--lobe", "student", "--weighting", "none") == dsbrdf.FitOptions(lobe="student")
    assert options_of("--no-robust") == options_of() == dsbrdf.FitOptions()
