"""Flags of ``dsbrdf fit`` become options of the fit."""

import inspect
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import dsbrdf
from dsbrdf.cli import fit_arguments as flags
from dsbrdf.cli import main as cli
from dsbrdf.cli.arguments import Parser
from tests.support.command_line import Capture, exit_code, sentence

# options of the fit


def options_of(*words: str) -> dsbrdf.FitOptions:
    parser = Parser()
    flags.add_fit_options(parser)
    return flags.fit_options(parser.parse_args(words))


def test_no_flags_give_the_default_options() -> None:
    assert options_of() == dsbrdf.FitOptions()


def test_every_option_has_a_flag_with_help(capsys: Capture) -> None:
    with pytest.raises(SystemExit):
        cli.main(["fit", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for field in fields(dsbrdf.FitOptions):
        flag = f"--{field.name.replace('_', '-')}"
        assert f" {flag}" in text
    assert "[rad]" not in text
    assert "(default: 80)" in text


def test_every_angle_option_is_converted_from_degrees() -> None:
    names = {field.name for field in fields(dsbrdf.FitOptions)}
    angles = {name for name, text in flags._field_descriptions().items() if "[rad]" in text}
    assert angles == flags.ANGLE_FIELDS & names


def test_help_is_the_same_for_indented_and_cleaned_docstrings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python 3.13 takes the indentation off."""
    texts = flags._field_descriptions()
    assert set(texts) == {field.name for field in fields(dsbrdf.FitOptions)}
    monkeypatch.setattr(dsbrdf.FitOptions, "__doc__", inspect.cleandoc(dsbrdf.FitOptions.__doc__ or ""))
    assert flags._field_descriptions() == texts


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
        (["--weighting", "heavy"], "--weighting: must be balanced or plain or cosine or log or none, not 'heavy'"),
        (["--lobe", "ggx"], "--lobe: must be hemi_epd or student, not 'ggx'"),
        (["--method", "paper", "--lobe", "student"], 'the method "paper" has the lobe "hemi_epd" only'),
        (["--method", "paper", "--weighting", "balanced"], 'the method "paper" has no weighting "balanced"'),
        (["--horizon-cutoff", "100"], "cutoff must lie above 0 and at most at 90 degrees, not at 100"),
        (["--horizon-cutoff", "nan"], "cutoff must lie above 0"),
        (["--mask", "1,2"], "--mask: must be none or a number, not '1,2'"),
        (["--jobs", "0"], "the number of fits that run at once, must be at least 1, not 0"),
        (["--jobs", "many"], "--jobs: must be a whole number, not 'many'"),
        (["--scheduler", "host"], "--scheduler: must be an address such as tcp://host:8786, not 'host'"),
        (["--scheduler", "tcp://host"], "--scheduler: must be an address such as"),
        (["--no-such-flag"], "unrecognized arguments: --no-such-flag"),
    ],
)
def test_invalid_options_are_refused_in_one_sentence(
    words: list[str], said: str, plastic_file: Path, capsys: Capture
) -> None:
    assert exit_code(["fit", str(plastic_file), *words]) == 2
    assert said in sentence(capsys)
