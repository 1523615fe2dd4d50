"""Materials of a folder, their fits, and what is computed of them.

Whatever is computed of a material is kept in a folder beside the figures. A run that was interrupted goes on from
there, and figures share their fits. A kept result counts for the same file, settings and version of the algorithm.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from joblib import Memory, Parallel, delayed
from joblib.externals.loky import get_reusable_executor  # type: ignore[import-untyped]
from numpy.typing import NDArray

from dsbrdf import (
    ALGORITHM_VERSION,
    ConvergenceWarning,
    DSBRDFError,
    FitOptions,
    FitResult,
    InvalidArgumentError,
    Measurement,
    Profiles,
    fit,
    read_merl,
)

__all__ = [
    "STAND_INS",
    "Computed",
    "Failure",
    "Material",
    "Numbers",
    "choose",
    "compute",
    "find_materials",
    "fit_quietly",
]

Numbers = dict[str, NDArray[Any]]
Measure = Callable[["Material"], Numbers]

STAND_INS = "merl_*"
"""Names of files that are not measurements but were decoded from a description of a material, unless told otherwise."""


@dataclass(frozen=True)
class Material:
    """One measurement file, and the folder in which its fits are kept.

    A stand-in is not measured: another program's description of a material was decoded into a table.
    """

    file: Path
    kept: Path
    measured: bool = True

    @property
    def name(self) -> str:
        """Name of the file without its suffix."""
        return self.file.stem

    @cached_property
    def measurement(self) -> Measurement:
        """The measurement, read when it is first used."""
        return read_merl(self.file)

    @property
    def changed(self) -> int:
        """When the file was changed last [ns]: what is kept of another state of it does not count."""
        return self.file.stat().st_mtime_ns

    def fit(
        self, *, method: Literal["global", "paper"] = "global", n_lobes: int | Literal["auto"] = "auto"
    ) -> FitResult:
        """Fit the measurement, or take the fit that is kept."""
        options = FitOptions(method=method, n_lobes=n_lobes)
        fit_once = Memory(self.kept, verbose=0).cache(_fit, ignore=["material"])
        return fit_once(self, self.file, self.changed, options, ALGORITHM_VERSION)


def _fit(material: Material, _file: Path, _changed: int, options: FitOptions, _algorithm: int) -> FitResult:
    return fit_quietly(material.measurement, options)


@dataclass(frozen=True, eq=False)
class Computed:
    """What was computed of a material, arrays by name."""

    name: str
    measured: bool
    numbers: Numbers

    def __getitem__(self, key: str) -> NDArray[Any]:
        return self.numbers[key]

    @property
    def data(self) -> str:
        """What kind of data this is, in one word."""
        return "measured" if self.measured else "stand-in"

    @property
    def label(self) -> str:
        """Name for a figure; stand-ins are marked with an asterisk."""
        return self.name if self.measured else f"{self.name}*"


@dataclass(frozen=True)
class Failure:
    """A material that could not be computed, and why."""

    file: Path
    message: str


def find_materials(
    folder: Path, kept: Path, *, names: Sequence[str] = (), stand_ins: str = STAND_INS
) -> tuple[Material, ...]:
    """Find the measurements of a folder; `names` are with or without what precedes the first ``_`` of a file's name.

    Raises InvalidArgumentError if there is no such folder or file.
    """
    if not folder.is_dir():
        raise InvalidArgumentError(f"{folder} is not a folder; name a folder of measurements")
    files = sorted(folder.glob("*.binary"))
    if not files:
        raise InvalidArgumentError(f"{folder} contains no .binary file; name a folder of measurements")
    found = {file: {file.stem, file.stem.partition("_")[2]} for file in files}
    for name in names:
        if not any(name in known for known in found.values()):
            raise InvalidArgumentError(f"{folder} contains no material {name}")
    return tuple(
        Material(file, kept, measured=not fnmatch(file.stem, stand_ins))
        for file, known in found.items()
        if not names or known & set(names)
    )


def choose(materials: Sequence[Material], preferred: Sequence[str], count: int) -> list[Material]:
    """Return `count` materials: the preferred ones that are there, in their order, then evenly spaced others."""
    by_name = {material.name.partition("_")[2] or material.name: material for material in materials}
    by_name |= {material.name: material for material in materials}
    chosen = list(dict.fromkeys(by_name[name] for name in preferred if name in by_name))[:count]
    others = [material for material in materials if material not in chosen]
    missing = min(count - len(chosen), len(others))
    places = np.linspace(0, len(others) - 1, missing).round().astype(int)
    return chosen + [others[place] for place in places]


def compute(
    materials: Sequence[Material],
    measure: Measure,
    folder: Path,
    *,
    settings: str = "",
    jobs: int = 1,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[list[Computed], list[Failure]]:
    """Compute numbers of every material, several at once in processes of their own; return failures beside them.

    The numbers are kept in a folder until the material or the settings change. Raises InvalidArgumentError if `jobs`,
    the number of processes, is less than 1; with 1 everything is computed in this process.
    """
    if jobs < 1:
        raise InvalidArgumentError(f"jobs, the number of processes, must be at least 1, not {jobs}")
    outcomes = Parallel(n_jobs=jobs, return_as="generator")(
        delayed(_outcome)(replace(material), measure, folder, settings) for material in materials
    )
    computed, failures = list[Computed](), list[Failure]()
    for done, (material, outcome) in enumerate(zip(materials, outcomes, strict=True), start=1):
        if isinstance(outcome, Failure):
            failures.append(outcome)
        else:
            computed.append(Computed(material.name, material.measured, outcome))
        progress(done)
    get_reusable_executor().shutdown()  # else its processes stay for minutes
    return computed, failures


def fit_quietly(measurement: Measurement | Profiles, options: FitOptions) -> FitResult:
    """Fit without the warning that some slices did not converge: the figures show how good the fit is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return fit(measurement, options)


def _outcome(material: Material, measure: Measure, folder: Path, settings: str) -> Numbers | Failure:
    """Compute the numbers of a copy of a material, whose measurement does not stay in memory, or take those kept."""
    measure_once = Memory(folder, verbose=0).cache(_measure, ignore=["material", "measure"])
    try:
        return measure_once(material, measure, material.file, material.changed, settings, ALGORITHM_VERSION)
    except DSBRDFError as error:
        return Failure(material.file, str(error))


def _measure(
    material: Material,
    measure: Measure,
    _file: Path,
    _changed: int,
    _settings: str,
    _algorithm: int,
) -> Numbers:
    return measure(material)
