"""Define the parameters of commands: files, options of fits and of tables, and points in degrees."""

import errno
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Group, Parameter, Token, convert

from dsbrdf.arrays import Array
from dsbrdf.cli.commands import Whole
from dsbrdf.components.component import Component
from dsbrdf.components.layers import LayeredModel
from dsbrdf.data.files import known_kind
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import DSBRDFError, InvalidArgumentError, ModelFormatError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import PARTS, part_of
from dsbrdf.output.serialize import read_model_file
from dsbrdf.result import FitReport
from dsbrdf.samples.reading import RGL_START, START_BYTES, read_measurement
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.samples.table_options import AS_WRITTEN, TableOptions

ModelFile = Annotated[Path, Parameter(help="A .json file from dsbrdf fit.")]
SourceFile = Annotated[Path, Parameter(help="A .json model, a .binary or .bsdf measurement, or a table of samples.")]
RequiredFiles = Annotated[Path, Parameter(required=True)]
OutputFile = Annotated[Path, Parameter(alias="-o", metavar="FILE")]
ComponentName = Annotated[
    str | None,
    Parameter(choices=PARTS, help="One component, or the layers of all components, instead of the model."),
]
Json = Annotated[bool, Parameter(help="Print one JSON document instead of text.")]


_WORDS = {"none": None, "auto": "auto"}


def _angles_or_word(kind: Any, tokens: Sequence[Token]) -> float | tuple[int, ...] | str | None:
    """Convert one angle, several whole angles, or a word such as "auto"; the class of options checks the word."""
    text = ",".join(token.value for token in tokens)
    if text in _WORDS:
        return _WORDS[text]
    if kind is float:
        return float(convert(float, tokens))
    return tuple(convert(int, [tokens[0].evolve(value=part)]) for part in re.split(r"[,\s]+", text))


CountOrAuto = Annotated[int | Literal["auto"], Whole, Parameter(metavar="N|auto", show_choices=False)]
NumberOrAuto = Annotated[float | Literal["auto"], Parameter(metavar="NUMBER|auto", show_choices=False)]
_ANGLE = Parameter(converter=_angles_or_word, n_tokens=1, show_default="{:g}".format, metavar="DEGREES|none")
_ANGLES = Parameter(converter=_angles_or_word, n_tokens=1, metavar="DEGREES,...|auto", show_choices=False)


def _in_words(documented: type) -> str:
    """Return the docstring of a class of options as help for flags: None becomes "none", without backticks."""
    return (documented.__doc__ or "").replace("None", '"none"').replace("`", "")


def _several(kind: Any, tokens: Sequence[Token]) -> tuple[float, ...] | str:
    """Convert numbers that are separated by commas or blanks; return a text without numbers unchanged."""
    text = ",".join(token.value for token in tokens)
    if kind == tuple[float, ...] | float:
        return tuple(convert(float, [tokens[0].evolve(value=part)]) for part in re.split(r"[,\s]+", text.strip()))
    return text


_SEVERAL = Parameter(converter=_several, n_tokens=1)


@dataclass(frozen=True)
class TableFlags(TableOptions):
    """Offer the fields of `TableOptions` as flags of a command."""

    __doc__ = _in_words(TableOptions)

    columns: Annotated[tuple[str, ...] | str, _SEVERAL, Parameter(metavar="MEANING=COLUMN,...")] = ()
    constants: Annotated[tuple[str, ...] | str, _SEVERAL, Parameter(metavar="MEANING=DEGREES,...")] = ()
    missing: Annotated[tuple[float, ...] | float, _SEVERAL, Parameter(metavar="NUMBER,...")] = ()
    scale: Annotated[float, Parameter(metavar="FACTOR")] = 1.0

    def options(self) -> TableOptions:
        """Return these flags as `TableOptions`."""
        return TableOptions(**vars(self))


_OF_TABLES = Group("Options of a table of samples", sort_key=3)
AboutTable = Annotated[TableFlags, Parameter(name="*", group=_OF_TABLES)]
"""Type of a command's parameter that takes the options for reading a table."""
NO_TABLE_FLAGS = TableFlags()


@dataclass(frozen=True)
class FitFlags(FitOptions):
    """Offer the fields of `FitOptions` as flags of a command; only the fields here need another type."""

    __doc__ = _in_words(FitOptions)

    n_lobes: CountOrAuto = FitOptions.n_lobes
    ring_lobes: CountOrAuto = FitOptions.ring_lobes
    knots_deg: Annotated[tuple[int, ...] | Literal["auto"], _ANGLES] = FitOptions.knots_deg
    mask: NumberOrAuto = FitOptions.mask
    horizon_cutoff_deg: Annotated[float | None, _ANGLE] = FitOptions.horizon_cutoff_deg
    robust: Annotated[bool, Parameter(negative="--no-robust")] = FitOptions.robust
    em_iterations: Annotated[int, Whole] = FitOptions.em_iterations

    def options(self) -> FitOptions:
        """Return these flags as `FitOptions`."""
        return FitOptions(**vars(self))


Flags = Annotated[FitFlags, Parameter(name="*", group=Group("Options of the fit", sort_key=2))]
"""Type of a command's parameter that takes the options of a fit."""

DEFAULT = FitFlags()


def _each(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert the values of an option from the text into which `dsbrdf.cli.arguments.join_points` joined them."""
    between = r"[,\s]+" if kind == tuple[float, ...] else r"\s+"  # Commas separate angles, but are parts of directions.
    values = (value for token in tokens for value in re.split(between, token.value.strip()))
    return convert(kind, [tokens[0].evolve(value=value) for value in values])


_PLAIN = Parameter(help="An angle, or several.")
_Angles = Annotated[tuple[float, ...], Parameter(metavar="DEGREES...", converter=_each)]
_Directions = Annotated[
    tuple[str, ...], Parameter(metavar="X,Y,Z...", converter=_each, help="A unit vector, or several.")
]


_FORMS = (("theta_half", "theta_diff", "phi_diff"), ("theta_in", "theta_out", "phi_out"), ("omega_in", "omega_out"))
_PAIRS = "--theta-half and --theta-diff, --theta-in and --theta-out, or --omega-in and --omega-out"
_DEFAULTS = {"phi_diff": (90.0,), "phi_out": (180.0,)}


@Parameter(name="*", group=Group("Points", sort_key=2))
@dataclass(frozen=True)
class Points:
    """Options for the angles or pairs of directions at which a model is evaluated.

    Attributes
    ----------
    phi_diff
        An angle, or several; by default 90, where both directions have equal angles to the normal.
    theta_in
        Angle of omega_in to the normal, or several.
    theta_out
        Angle of omega_out to the normal, or several.
    phi_out
        Azimuth from omega_in to omega_out; by default 180, on the side of the mirror direction.
    """

    theta_half: Annotated[_Angles, _PLAIN] = ()
    theta_diff: Annotated[_Angles, _PLAIN] = ()
    phi_diff: _Angles = ()
    theta_in: _Angles = ()
    theta_out: _Angles = ()
    phi_out: _Angles = ()
    omega_in: _Directions = ()
    omega_out: _Directions = ()

    def arrays(self) -> dict[str, Array]:
        """Return the points as arrays by name; a single value is combined with all values of other options.

        The names are ``theta_half_deg``, ``theta_diff_deg`` and ``phi_diff_deg``, or ``theta_in_deg``,
        ``theta_out_deg`` and ``phi_out_deg``, with shape (n,) [degrees], or ``omega_in`` and ``omega_out`` with shape
        (n, 3). Raises InvalidArgumentError if a value is missing or wrong, ways to describe points are mixed, or
        options have different numbers of values.
        """
        used = [form for form in _FORMS if any(getattr(self, name) for name in form)]
        if len(used) > 1:
            raise InvalidArgumentError(f"give either {_PAIRS}")
        columns: dict[str, Array] = {}
        for name in used[0] if used else _FORMS[0]:
            given = getattr(self, name) or _DEFAULTS.get(name, ())
            if not given:
                raise InvalidArgumentError(f"--{name.replace('_', '-')} is missing: give {_PAIRS}")
            is_angle = not name.startswith("omega")
            columns[f"{name}_deg" if is_angle else name] = np.array(given if is_angle else list(map(_direction, given)))
        length = max(len(array) for array in columns.values())
        if any(len(array) not in (1, length) for array in columns.values()):
            counts = ", ".join(f"{len(array)} {name}" for name, array in columns.items())
            raise InvalidArgumentError(f"{counts} cannot be combined: give equally many of each, or one")
        return {name: np.repeat(array, length // len(array), axis=0) for name, array in columns.items()}


def _direction(text: str) -> list[float]:
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise InvalidArgumentError(f"a direction must be three numbers x,y,z, not {text!r}") from None
    return [x, y, z]


def is_measurement(path: Path) -> bool:
    """Return whether a path names a measurement and not a model, which is a ``.json`` file."""
    return path.suffix.lower() != ".json"


_SUFFIXES_OF_MEASUREMENTS = (".binary", ".bsdf", ".csv")
_N_COMPARED_BYTES = 64  # Exports of one kind begin with equal bytes, which differ from those of a measurement.


def check_output(output: Path, inputs: Sequence[Path], content: bytes = b"") -> None:
    """Raise an error if a file cannot be written, or if it is an input or the measurement beside an input model.

    A file that begins as `content` does is an earlier output. The error is FileNotFoundError if there is no folder, and
    InvalidArgumentError otherwise.
    """
    if not output.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(output))
    if not output.is_file():
        return
    beside = [path.with_suffix(output.suffix) for path in inputs if not is_measurement(path)]
    kept = [*inputs, *(beside if output.suffix.lower() in _SUFFIXES_OF_MEASUREMENTS else ())]
    with output.open("rb") as file:
        is_earlier = content != b"" and file.read(_N_COMPARED_BYTES) == content[:_N_COMPARED_BYTES]
    if not is_earlier and any(path.exists() and output.samefile(path) for path in kept):
        raise InvalidArgumentError(
            f"{output} may be a measurement or a model, and is not replaced: name another file to write"
        )


@contextmanager
def named_in_errors(path: Path) -> Iterator[None]:
    """Put the name of a file before the message of an error."""
    try:
        yield
    except DSBRDFError as error:
        raise type(error)(f"{path}: {error}") from error


def read_measured(path: Path, options: TableOptions = AS_WRITTEN) -> Measurement | ScatteredSamples:
    """Read a measurement, with `options` if it is a table of samples; an error names the file."""
    with named_in_errors(path):
        return read_measurement(path, options)


def read_grid(path: Path) -> Measurement:
    """Read a measurement on the grid (``.binary`` or ``.bsdf``); an error names the file."""
    measurement = read_measured(path)
    with named_in_errors(path):
        if not isinstance(measurement, Measurement):
            raise InvalidArgumentError("the file is a table of samples, not a measurement on a grid; fit it first")
        return measurement


def read_model(path: Path) -> tuple[DSBRDF, FitReport | None]:
    """Read a model (``.json``) and its report, if any; an error names the file and its kind."""
    with named_in_errors(path):
        with path.open("rb") as file:
            start = file.read(START_BYTES)
        kind = known_kind(start)
        if is_measurement(path) and start.lstrip()[:1] != b"{" and (kind is None or start.startswith(RGL_START)):
            raise InvalidArgumentError(
                "this command reads models, not measurements; fit it first with dsbrdf fit -o DIR"
            )
        if kind is not None:
            raise ModelFormatError(f"the file is {kind.name}; a stored model is a .json file")
        return read_model_file(path)


def named_part(path: Path, model: DSBRDF, part: str | None) -> DSBRDF | LayeredModel | Component:
    """Return a component or the layers of the model in a file, or the model itself; an error names the file."""
    with named_in_errors(path):
        return part_of(model, part)


def read_source(path: Path) -> Measurement | DSBRDF:
    """Read a measurement on the grid, or a model (``.json``); an error names the file."""
    return read_grid(path) if is_measurement(path) else read_model(path)[0]
