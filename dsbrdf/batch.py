"""Fitting many files: several at once, one bad file does not stop the others, and an interrupted run resumes."""

import json
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

from dsbrdf.errors import InvalidArgumentError, ModelFormatError
from dsbrdf.fit import ALGORITHM_VERSION, FitOptions, FitResult
from dsbrdf.serialize import from_json, save
from dsbrdf.workers import FileFit, default_jobs, fit_in_processes


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
    jobs: int | None = None,
    force: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Generator[FileFit, None, None]:
    """Fit files, several at once, in processes of their own.

    Every model is written as soon as its fit is done, by this process, whole or not at all.  Closing the iterator
    ends the processes.

    Parameters
    ----------
    files : sequence of Path
        MERL measurements.
    options : FitOptions
        For all of them.
    folder : Path, optional
        Where to write ``NAME.json`` for each file; made if it does not exist.
    jobs : int, optional
        Fits that run at once; by default one for each CPU.
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
        If two files would be written to the same output, or ``jobs`` is less than 1.
    OSError
        If an output cannot be written.
    """
    if jobs is not None and jobs < 1:
        raise InvalidArgumentError(f"jobs, the number of fits that run at once, must be at least 1, not {jobs}")
    outputs = _outputs(files, folder)
    done: dict[int, FileFit] = {}
    shares = [0.0] * len(files)
    yielded = 0

    def to_fit() -> Iterator[tuple[int, Path]]:
        for number, (file, output) in enumerate(zip(files, outputs, strict=True)):
            kept = None if output is None or force else _earlier_result(file, output, options)
            if kept is None:
                yield number, file
            else:
                done[number] = FileFit(file, output, kept, resumed=True)

    with closing(fit_in_processes(to_fit(), options, default_jobs() if jobs is None else jobs)) as messages:
        for number, message in messages:
            if isinstance(message, FileFit):
                done[number] = _written(message, outputs[number])
            else:
                shares[number] = message
            if progress is not None:
                progress(len(done) + sum(share for at, share in enumerate(shares) if at not in done))
            while yielded in done:
                yield done[yielded]
                yielded += 1
    yield from (done[number] for number in range(yielded, len(files)))


def _written(item: FileFit, output: Path | None) -> FileFit:
    """Write the model, if there is one and somewhere to write it."""
    if item.result is None or output is None:
        return item
    save(item.result, output)
    return replace(item, output=output)


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
