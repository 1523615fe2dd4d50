"""Fitting many files: one bad file does not stop the others, and an interrupted run resumes."""

import json
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from dsbrdf.errors import ConvergenceWarning, DSBRDFError, InvalidArgumentError, ModelFormatError
from dsbrdf.fit import ALGORITHM_VERSION, FitOptions, FitResult, fit
from dsbrdf.merl import read_merl
from dsbrdf.serialize import from_json, save

UNREADABLE = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, PermissionError)
"""Errors of the operating system that mean a wrong path, not a fault of the machine."""


@dataclass(frozen=True)
class FileFit:
    """What became of one file.

    Attributes
    ----------
    file : Path
        The measurement.
    output : Path or None
        The model's file; None where nothing was to be written.
    result : FitResult or None
        The fit; None where it failed.
    error : str or None
        One sentence that says why it failed.
    warnings : tuple of str
        Sentences of the fit about its convergence.
    resumed : bool
        Whether the result was taken from an earlier run.
    """

    file: Path
    output: Path | None = None
    result: FitResult | None = None
    error: str | None = None
    warnings: tuple[str, ...] = ()
    resumed: bool = False


def measurement_files(paths: Sequence[Path]) -> list[Path]:
    """Replace every folder by the ``.binary`` files in it.

    Raises
    ------
    InvalidArgumentError
        If a folder holds none.
    """
    files: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.binary")) if path.is_dir() else [path]
        if not inside:
            raise InvalidArgumentError(f"{path} holds no .binary file; name a folder of measurements, or files")
        files += inside
    return files


def fit_files(
    files: Sequence[Path],
    options: FitOptions,
    folder: Path | None = None,
    *,
    force: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Iterator[FileFit]:
    """Fit files one after the other.

    Parameters
    ----------
    files : sequence of Path
        MERL measurements.
    options : FitOptions
        For all of them.
    folder : Path, optional
        Where to write ``NAME.json`` for each file; made if it does not exist.
    force : bool, optional
        Fit again where the folder holds a fit already.  Otherwise a fit is kept that is younger than its
        measurement and was made with the same options by the same version of the algorithm.
    progress : callable, optional
        Called with the number of files done, fractions included.

    Yields
    ------
    FileFit
        One for each file, in order.

    Raises
    ------
    InvalidArgumentError
        If two files would be written to the same output.
    OSError
        If an output cannot be written.
    """
    outputs = _outputs(files, folder)
    for number, (file, output) in enumerate(zip(files, outputs, strict=True)):
        kept = None if output is None or force else _earlier_result(file, output, options)
        if kept is not None:
            yield FileFit(file, output, kept, resumed=True)
        else:
            yield _fit_file(file, output, options, _share(progress, number))
        if progress is not None:
            progress(number + 1.0)


def _outputs(files: Sequence[Path], folder: Path | None) -> Sequence[Path | None]:
    if folder is None:
        return [None] * len(files)
    folder.mkdir(parents=True, exist_ok=True)
    taken: dict[Path, Path] = {}
    for file in files:
        output = folder / f"{file.stem}.json"
        if output in taken:
            raise InvalidArgumentError(
                f"{taken[output]} and {file} would both be written to {output}; fit them into different folders"
            )
        taken[output] = file
    return list(taken)


def _fit_file(
    file: Path, output: Path | None, options: FitOptions, progress: Callable[[float], None] | None
) -> FileFit:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConvergenceWarning)
        try:
            result = fit(read_merl(file), options, progress=progress)
        except DSBRDFError as error:
            return FileFit(file, error=str(error))
        except UNREADABLE as error:
            return FileFit(file, error=error.strerror or str(error))
    if output is not None:
        save(result, output)
    return FileFit(file, output, result, warnings=tuple(str(warning.message) for warning in caught))


def _earlier_result(file: Path, output: Path, options: FitOptions) -> FitResult | None:
    """Return the fit in ``output`` if it is the one that would be made now."""
    try:
        if output.stat().st_mtime < file.stat().st_mtime:
            return None
        model, report = from_json(output.read_text(encoding="utf-8"))
    except (FileNotFoundError, UnicodeDecodeError, ModelFormatError):
        return None
    wanted = json.loads(json.dumps(asdict(options)))
    if report is None or report.options != wanted or report.versions.get("algorithm") != ALGORITHM_VERSION:
        return None
    return FitResult(model, report)


def _share(progress: Callable[[float], None] | None, number: int) -> Callable[[float], None] | None:
    """Progress of one file as progress of them all."""
    return None if progress is None else lambda share: progress(number + share)
