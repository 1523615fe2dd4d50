"""Fitting many files: several at once, one bad file does not stop the others, and an interrupted run resumes."""

import asyncio
import json
import os
import queue
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine, Fault, FitTask, Outcome
from dsbrdf.engines.local import LocalEngine
from dsbrdf.errors import InvalidArgumentError, ModelFormatError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import from_json, save
from dsbrdf.version import ALGORITHM_VERSION

UNREADABLE = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, PermissionError)
"""Errors of the operating system that mean a wrong path, not a fault of the machine."""

_PATIENCE = 15.0  # seconds that a cluster gets to answer and to have a worker

_Message = tuple[int, "float | FileFit"]


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
    lost : bool
        Whether it failed through no fault of the measurement: its process died, or the machine could not read it.
    warnings : tuple of str
        Sentences of the fit about its convergence.
    resumed : bool
        Whether the result was taken from an earlier run.
    """

    file: Path
    output: Path | None = None
    result: FitResult | None = None
    error: str | None = None
    lost: bool = False
    warnings: tuple[str, ...] = ()
    resumed: bool = False


def default_jobs() -> int:
    """Return the number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
    scheduler: str | None = None,
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
        Fits that run at once; by default one for each CPU.  With a scheduler: measurements that are read at once.
    scheduler : str, optional
        Address of a Dask scheduler, such as ``tcp://host:8786``, whose workers fit; see `dsbrdf.engines.dask`.
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
        If an output cannot be written, or no worker of the cluster can be reached.
    MissingExtraError
        If there is a scheduler and Dask is not installed.
    """
    if jobs is not None and jobs < 1:
        raise InvalidArgumentError(f"jobs, the number of fits that run at once, must be at least 1, not {jobs}")
    outputs = _outputs(files, folder)
    count = default_jobs() if jobs is None else jobs
    engine = LocalEngine(count) if scheduler is None else DaskEngine(scheduler, count)
    done: dict[int, FileFit] = {}
    shares = [0.0] * len(files)
    yielded = 0

    def to_fit() -> Iterator[tuple[int, Path, FileFit | None]]:
        for number, (file, output) in enumerate(zip(files, outputs, strict=True)):
            known = _unreadable(file)
            if known is None and output is not None and not force:
                known = _earlier_fit(file, output, options)
            yield number, file, known

    with closing(_messages(engine, to_fit(), options)) as messages:
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


def _messages(
    engine: Engine, files: Iterable[tuple[int, Path, FileFit | None]], options: FitOptions
) -> Generator[_Message, None, None]:
    """Fit the files of which nothing is known; closing the iterator, or an exception in it, ends the processes at once.

    The engine's event loop is in a thread of its own: it goes on while the caller does something else, and the caller
    may have one itself.
    """
    messages: queue.SimpleQueue[_Message | BaseException | None] = queue.SimpleQueue()
    loop = asyncio.new_event_loop()
    fitting = loop.create_task(_fit_all(engine, files, options, messages.put))

    def run() -> None:
        with closing(loop):
            loop.run_until_complete(asyncio.wait([fitting]))
            messages.put(None if fitting.cancelled() else fitting.exception())
            loop.run_until_complete(loop.shutdown_default_executor())

    thread = threading.Thread(target=run, name="dsbrdf-engine")
    thread.start()
    try:
        while (message := messages.get()) is not None:
            if isinstance(message, BaseException):
                raise message
            yield message
    finally:
        if thread.is_alive():
            loop.call_soon_threadsafe(fitting.cancel)
        thread.join()


async def _fit_all(
    engine: Engine,
    files: Iterable[tuple[int, Path, FileFit | None]],
    options: FitOptions,
    tell: Callable[[_Message], None],
) -> None:
    async def fit_one(number: int, file: Path, begun: asyncio.Event) -> None:
        async with engine.turn():
            begun.set()
            outcome = await engine.run(FitTask(file.stem, file, options), lambda share: tell((number, share)))
        tell((number, _file_fit(file, outcome)))

    tasks: set[asyncio.Task[None]] = set()
    try:
        for number, file, known in files:
            if known is not None:
                tell((number, known))
                continue
            if not tasks:
                await engine.start()
                await _until_ready(engine)
            begun = asyncio.Event()
            tasks.add(asyncio.create_task(fit_one(number, file, begun)))
            await begun.wait()
        await asyncio.gather(*tasks)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await engine.close()


async def _until_ready(engine: Engine) -> None:
    deadline = time.monotonic() + _PATIENCE
    while True:
        try:
            return await engine.check()
        except RuntimeError as error:
            if time.monotonic() > deadline:
                raise ConnectionError(str(error)) from error
        await asyncio.sleep(0.1)


def _file_fit(file: Path, outcome: Outcome) -> FileFit:
    if isinstance(outcome, Fault):
        lost = outcome.origin != "input"
        advice = "; run the command again, with fewer --jobs if memory was short" if lost else ""
        return FileFit(file, error=outcome.message.rstrip(".") + advice if lost else outcome.message, lost=lost)
    model, report = from_json(outcome.document)
    if report is None:
        raise ValueError("the document of a fit has a report")
    return FileFit(file, result=FitResult(model, report), warnings=outcome.warnings)


def _unreadable(file: Path) -> FileFit | None:
    """Tell at once of a file that cannot be opened."""
    try:
        os.close(os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)))  # a pipe without a writer would block
    except OSError as error:
        return FileFit(file, error=error.strerror or str(error), lost=not isinstance(error, UNREADABLE))
    return None


def _written(item: FileFit, output: Path | None) -> FileFit:
    """Write the model, if there is one and somewhere to write it."""
    if item.result is None or output is None or item.resumed:
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


def _earlier_fit(file: Path, output: Path, options: FitOptions) -> FileFit | None:
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
    return FileFit(file, output, FitResult(model, report), resumed=True)
