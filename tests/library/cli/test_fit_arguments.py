"""Flags of ``dsbrdf fit`` become options of the fit."""

import inspect
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from cyclopts import App

import dsbrdf
from dsbrdf.cli import main as cli
from dsbrdf.cli.parameters import DEFAULT, Flags
from tests.support.command_line import Capture, exit_code, sentence

# options of the fit


def options_of(*words: str) -> dsbrdf.FitOptions:
    def command(*, flags: Flags = DEFAULT) -> dsbrdf.FitOptions:
        return flags.options()

    options: dsbrdf.FitOptions = App(default_command=command, result_action="return_value")(words)
    return options


def test_no_flags_give_the_default_options() -> None:
    assert options_of() == dsbrdf.FitOptions()


def descriptions() -> dict[str, str]:
    """What the docstring of the options says of each field."""
    text = inspect.getdoc(dsbrdf.FitOptions) or ""
    entries = re.findall(r"^(\w+) : .*\n((?:    .+(?:\n|$))+)", text, flags=re.MULTILINE)
    assert {name for name, _ in entries} == {field.name for field in fields(dsbrdf.FitOptions)}
    return {name: " ".join(text.split()) for name, text in entries}


def test_every_option_has_a_flag_with_help(capsys: Capture) -> None:
    assert cli.main(["fit", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
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
    assert options_of("--weighting", "balanced").weighting == "balanced"
    assert options_of("--horizon-cutoff", "none").horizon_cutoff is None
    assert options_of("--no-robust").robust is False


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--n-lobes", "9"], "n_lobes must be"),
        (["--n-lobes", "two"], "--n-lobes: must be "),
        (["--n-lobes", "2.5"], "--n-lobes: must be "),
        (["--weighting", "heavy"], "--weighting: must be balanced or plain or cosine or log, not 'heavy'"),
        (["--lobe", "ggx"], "--lobe: must be hemi_epd or student, not 'ggx'"),
        (["--method", "paper", "--lobe", "student"], 'the method "paper" has the lobe "hemi_epd" only'),
        (["--method", "paper", "--weighting", "balanced"], 'the method "paper" has no weighting "balanced"'),
        (["--horizon-cutoff", "100"], "cutoff must lie above 0 and at most at 90 degrees, not at 100"),
        (["--horizon-cutoff", "nan"], "cutoff must lie above 0"),
        (["--mask", "1,2"], "--mask: must be a number, not '1,2'"),
        (["--jobs", "0"], "the number of fits that run at once, must be at least 1, not 0"),
        (["--jobs", "2.5"], "--jobs: must be a whole number, not '2.5'"),
        (["--em-iterations", "0.5"], "--em-iterations: must be a whole number, not '0.5'"),
        (["--horizon-cutoff", "far"], "--horizon-cutoff: must be a number, not 'far'"),
        (["--knots", "0,x"], "--knots: must be a number, not 'x'"),
        (["--jobs", "many"], "--jobs: must be a whole number, not 'many'"),
        (["--scheduler", "host"], "--scheduler: must be an address such as tcp://host:8786, not 'host'"),
        (["--scheduler", "tcp://host"], "--scheduler: must be an address such as"),
        (["--no-such-flag"], "dsbrdf fit: there is no option --no-such-flag"),
    ],
)
def test_invalid_options_are_refused_in_one_sentence(
    words: list[str], said: str, plastic_file: Path, capsys: Capture
) -> None:
    assert exit_code(["fit", str(plastic_file), *words]) == 2
    assert said in sentence(capsys)
