"""Fit many files, several at once; a faulty file does not stop the others, and a repeated run skips finished files."""

import os
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, as_completed
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock

from dsbrdf.data.files import write_atomically
from dsbrdf.engines.engine import Engine, Fault, FitTask, OnProgress, Outcome, run_step
from dsbrdf.engines.local import LocalEngine, compute
from dsbrdf.errors import WRONG_PATH_ERRORS, InvalidArgumentError, ModelFormatError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.output.serialize import result_from_json
from dsbrdf.result import FitResult
from dsbrdf.samples.reading import samples_in
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.version import ALGORITHM_VERSION

_CLUSTER_TIMEOUT_S = 15.0  # A cluster without a usable worker for this time is refused.


@dataclass(frozen=True)
class FileFit:
    """The fit of one file, or the reason why the fit failed."""

    file: Path
    output: Path | None = None  # file of the model; None if the fit failed
    result: FitResult | None = None  # model and report; None if the fit failed
    error: str | None = None  # one sentence with the reason why the fit failed
    lost: bool = False  # whether the fit failed for a reason other than the measurement, so that it may succeed later
    resumed: bool = False  # whether the fit is from an earlier run


def measurement_files(paths: Sequence[Path]) -> list[Path]:
    """Replace each folder by its ``.binary`` files; raise InvalidArgumentError for a folder without such files."""
    files: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.binary")) if path.is_dir() else [path]
        if not inside:
            raise InvalidArgumentError(f"{path} contains no .binary file; name a folder of measurements, or files")
        files += inside
    return files


def fit_files(
    files: Sequence[Path],
    options: FitOptions,
    engine: Engine,
    folder: Path | None = None,
    *,
    samples_of: Callable[[Path], ScatteredSamples | None] = samples_in,
    force: bool = False,
    progress: OnProgress = lambda _: None,
) -> Generator[FileFit, None, None]:
    """Yield the fit of each file as soon as it is done; closing the iterator closes the engine and ends its processes.

    A single file is fitted in this process if the engine is a `LocalEngine`. Each model is written atomically to
    ``NAME.json`` in the `folder`, or, if the folder is None, beside its measurement, where a file that is not a fit is
    never replaced. The function `samples_of` reads a table, and returns None for a measurement on a grid. Without
    `force`, an earlier fit is kept if the fit is newer than its measurement, and has equal samples, options and
    algorithm version. `progress` is called, also in other threads, with the number of finished files, including
    fractions of unfinished files.

    Raises InvalidArgumentError if two files would have the same output, and OSError if an output cannot be written or
    no worker of the cluster can be reached.
    """
    # A single file is fitted in this process, because the start of a worker process takes time.
    is_single = len(files) == 1 and isinstance(engine, LocalEngine)
    shares, in_turn = [0.0] * len(files), Lock()

    def tell(number: int, share: float) -> None:
        with in_turn:
            shares[number] = share
            progress(sum(shares))

    numbers: dict[Future[Outcome], int] = {}
    with closing(engine):
        outputs = _outputs(files, folder)
        for number, (file, output) in enumerate(zip(files, outputs, strict=True)):
            found, samples = _unreadable(file), None
            if found is None and isinstance(samples := run_step(samples_of, file), Fault):
                found = _file_fit(file, output, samples)
            if found is None and not force:
                found = _earlier_fit(file, output, options, samples)
            task, on_progress = FitTask(file.stem, file, options, samples), partial(tell, number)
            if found is None and is_single:
                found = _file_fit(file, output, run_step(compute, task, on_progress))
            if found is None:
                if not numbers:
                    _wait_until_ready(engine)
                numbers[engine.submit(task, on_progress)] = number
            else:
                tell(number, 1.0)
                yield found
        for future in as_completed(numbers):
            number = numbers[future]
            found = _file_fit(files[number], outputs[number], future.result())
            tell(number, 1.0)
            yield found


def _unreadable(file: Path) -> FileFit | None:
    """Return a failed fit if a file cannot be opened, otherwise None."""
    try:
        # O_NONBLOCK lets `open` return if the file is a pipe without a writer.
        os.close(os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)))
    except OSError as error:
        return FileFit(file, error=error.strerror or str(error), lost=not isinstance(error, WRONG_PATH_ERRORS))
    return None


def _wait_until_ready(engine: Engine) -> None:
    deadline = time.monotonic() + _CLUSTER_TIMEOUT_S
    while True:
        try:
            return engine.check()
        except OSError:
            if time.monotonic() > deadline:
                raise
        time.sleep(0.1)


def _file_fit(file: Path, output: Path, outcome: Outcome) -> FileFit:
    """Write the outcome of a fit to the file `output`; beside a measurement, replace no file that is not a fit."""
    if isinstance(outcome, Fault):
        lost = outcome.origin != "input"
        advice = "; run the command again, with fewer --jobs if memory was short" if lost else ""
        return FileFit(file, error=outcome.message.rstrip(".") + advice if lost else outcome.message, lost=lost)
    if output.parent == file.parent and output.exists() and _stored_fit(output) is None:
        return FileFit(file, error=f"{output} is there already and is no fit; save the fit elsewhere with -o DIR")
    write_atomically(output, [outcome.text.encode()])
    return FileFit(file, output, result_from_json(outcome.text))


def _outputs(files: Sequence[Path], folder: Path | None) -> list[Path]:
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    taken: dict[Path, Path] = {}
    for file in files:
        output = (file.parent if folder is None else folder) / f"{file.stem}.json"
        if output in taken:
            raise InvalidArgumentError(
                f"{taken[output]} and {file} would both be written to {output}; fit them into different folders"
            )
        taken[output] = file
    return list(taken)


def _stored_fit(file: Path) -> FitResult | None:
    """Return the fit in a file; None if there is no such file, or it is no fit."""
    try:
        return result_from_json(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, UnicodeDecodeError, ModelFormatError):
        return None


def _earlier_fit(file: Path, output: Path, options: FitOptions, samples: ScatteredSamples | None) -> FileFit | None:
    """Return the fit in the file ``output`` if a new fit would give an equal result, otherwise None."""
    result = _stored_fit(output)
    if result is None or output.stat().st_mtime < file.stat().st_mtime:
        return None
    made = result.report.options, result.report.versions.algorithm, result.report.samples
    wanted = options, ALGORITHM_VERSION, None if samples is None else samples.sha256
    return FileFit(file, output, result, resumed=True) if made == wanted else None
