"""Materials of a folder, their fits, and what is computed of them.

Whatever is computed of a material is kept in a folder beside the figures, as soon as it is known.  A run that was
interrupted goes on from there, and figures share their fits.  A kept result counts as long as it is newer than its
measurement and was made by the same version of the algorithm with the same settings.
"""

import signal
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from functools import cached_property
from io import BytesIO
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import read_merl
from dsbrdf.data.reduction import Profiles
from dsbrdf.errors import ConvergenceWarning, DSBRDFError, InvalidArgumentError, ModelFormatError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import load_result, save
from dsbrdf.process_settings import end_with_parent, keep_freed_memory
from dsbrdf.version import ALGORITHM_VERSION

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
    """One measurement file.

    Attributes
    ----------
    file : Path
        A MERL ``.binary`` file.
    kept : Path
        Folder in which its fits are kept.
    measured : bool
        False for a stand-in, a table that was decoded from another program's description of a material.
    peer : Path or None
        A ``.binary`` file of the same material as another model encodes it.
    """

    file: Path
    kept: Path
    measured: bool = True
    peer: Path | None = None

    @property
    def name(self) -> str:
        """Name of the file without its suffix."""
        return self.file.stem

    @cached_property
    def measurement(self) -> Measurement:
        """The measurement, read when it is first used."""
        return read_merl(self.file)

    def fit(
        self, *, method: Literal["global", "paper"] = "global", n_lobes: int | Literal["auto"] = "auto"
    ) -> FitResult:
        """Fit the measurement, or take the fit that is kept."""
        options = FitOptions(method=method, n_lobes=n_lobes)
        path = self.kept / f"{self.name}.{method}-{n_lobes}.json"
        known = self._kept_fit(path, options)
        if known is not None:
            return known
        result = fit_quietly(self.measurement, options)
        path.parent.mkdir(parents=True, exist_ok=True)
        save(result, path)
        return result

    def _kept_fit(self, path: Path, options: FitOptions) -> FitResult | None:
        try:
            if path.stat().st_mtime < self.file.stat().st_mtime:
                return None
            result = load_result(path)
        except (FileNotFoundError, ModelFormatError):
            return None
        same = result.report.options == options and result.report.versions.algorithm == ALGORITHM_VERSION
        return result if same else None


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
    folder: Path, kept: Path, *, names: Sequence[str] = (), stand_ins: str = STAND_INS, peers: Path | None = None
) -> tuple[Material, ...]:
    """Find the measurements of a folder.

    Parameters
    ----------
    folder : Path
        With ``.binary`` files.
    kept : Path
        Folder for fits.
    names : sequence of str, optional
        Only these, with or without what precedes the first ``_`` of a file's name; by default all.
    stand_ins : str, optional
        Pattern of the names that are no measurements.
    peers : Path, optional
        Folder with the materials as another model encodes them, ``peer_NAME.binary`` for NAME.

    Raises
    ------
    InvalidArgumentError
        If there is no such folder or file.
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
        Material(file, kept, measured=not fnmatch(file.stem, stand_ins), peer=_peer(file, peers))
        for file, known in found.items()
        if not names or known & set(names)
    )


def _peer(file: Path, peers: Path | None) -> Path | None:
    path = None if peers is None else peers / f"peer_{file.name}"
    return path if path is not None and path.exists() else None


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
    """Compute numbers of every material, several at once in processes of their own.

    Parameters
    ----------
    materials : sequence of Material
    measure : callable
        A function of a module, so that another process finds it.
    folder : Path
        Where the numbers are kept.
    settings : str, optional
        What the numbers depend on besides the material: kept ones with other settings are computed again.
    jobs : int, optional
        Most processes; with 1 everything is computed in this one.
    progress : callable, optional
        Called with the number of materials done.

    Returns
    -------
    computed : list of Computed
        In the order of the materials.
    failures : list of Failure
        Materials that could not be read or fitted.

    Raises
    ------
    InvalidArgumentError
        If ``jobs`` is less than 1.
    ChildProcessError
        If a process died.
    """
    if jobs < 1:
        raise InvalidArgumentError(f"jobs, the number of processes, must be at least 1, not {jobs}")
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[Material, Numbers | Failure] = {}
    for material, outcome in _outcomes(materials, measure, folder, settings, jobs):
        found[material] = outcome
        progress(len(found))
    outcomes = [(material, found[material]) for material in materials]
    computed = [Computed(one.name, one.measured, got) for one, got in outcomes if not isinstance(got, Failure)]
    return computed, [got for _, got in outcomes if isinstance(got, Failure)]


def fit_quietly(measurement: Measurement | Profiles, options: FitOptions) -> FitResult:
    """Fit without the warning that some slices did not converge: the figures show how good the fit is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return fit(measurement, options)


def _outcomes(
    materials: Sequence[Material], measure: Measure, folder: Path, settings: str, jobs: int
) -> Iterator[tuple[Material, Numbers | Failure]]:
    """Yield what becomes known, the kept numbers first."""
    left = []
    for material in materials:
        known = _kept_numbers(_path(material, folder), material, settings)
        if known is None:
            left.append(material)
        else:
            yield material, known
    if jobs == 1 or len(left) < 2:
        for material in left:
            yield material, _measure_one(material, measure, folder, settings)
        return
    # A fork would take over the threads' locks; a new interpreter costs half a second.
    context = get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(left)), context, _prepare_process) as pool:
        running: dict[Future[Numbers | Failure], Material] = {
            pool.submit(_measure_one, material, measure, folder, settings): material for material in left
        }
        try:
            for future in as_completed(running):
                yield running[future], future.result()
        except BrokenProcessPool:
            raise ChildProcessError(_PROCESS_DIED) from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _prepare_process() -> None:
    """Let an interrupt end the run after the materials in progress: their numbers are kept."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    keep_freed_memory()


def _measure_one(material: Material, measure: Measure, folder: Path, settings: str) -> Numbers | Failure:
    try:
        numbers = measure(replace(material))  # a copy, whose measurement does not stay in memory
    except DSBRDFError as error:
        return Failure(material.file, str(error))
    content = BytesIO()
    about = np.array([str(ALGORITHM_VERSION), settings])
    np.savez_compressed(content, allow_pickle=False, **{_ABOUT: about}, **numbers)
    write_atomically(_path(material, folder), [content.getvalue()])
    return numbers


_ABOUT = "made_by"
_PROCESS_DIED = "a process died; run the command again, with fewer --jobs if memory was short: what is known is kept"


def _path(material: Material, folder: Path) -> Path:
    return folder / f"{material.name}.npz"


def _kept_numbers(path: Path, material: Material, settings: str) -> Numbers | None:
    """Return the numbers in a file, unless they are out of date or the file is damaged."""
    try:
        if path.stat().st_mtime < material.file.stat().st_mtime:
            return None
        with np.load(path, allow_pickle=False) as content:
            numbers = {name: content[name] for name in content.files}
    except (FileNotFoundError, BadZipFile, ValueError, EOFError):
        return None
    made_by = numbers.pop(_ABOUT, np.zeros(0)).tolist()
    return numbers if made_by == [str(ALGORITHM_VERSION), settings] else None
