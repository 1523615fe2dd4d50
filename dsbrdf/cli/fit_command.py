"""Define ``dsbrdf fit``, its progress bar, and its tables of several fits for the terminal and as CSV."""

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from cyclopts import Group, Parameter
from rich.console import Console
from rich.progress import BarColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

from dsbrdf.cli.arguments import BAD_INPUT, entry_point, print_json
from dsbrdf.cli.parameters import (
    DEFAULT,
    NO_TABLE_FLAGS,
    AboutTable,
    CountOrAuto,
    Flags,
    Json,
    RequiredFiles,
    check_output,
    read_model,
)
from dsbrdf.data.files import write_atomically
from dsbrdf.engines.batch import FileFit, fit_files, measurement_files
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine
from dsbrdf.engines.local import LocalEngine
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.extras import require
from dsbrdf.fitting.metrics import METRICS
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.documents import COLUMNS, component_documents, component_rows, table_csv
from dsbrdf.output.report_text import headline, result_document, result_text
from dsbrdf.process_settings import core_count, keep_freed_memory
from dsbrdf.samples.plan import plan_table
from dsbrdf.samples.reading import read_measurement, read_samples, samples_in
from dsbrdf.samples.scattered_fit import planned_pairs
from dsbrdf.samples.table_options import TableOptions

_FILES = (".json", ".png", ".svg", ".pdf", ".csv", ".binary")
_SCHEDULER = r"(tcp|tls|ws|wss)://[^/\s]+:[0-9]+"
_URL = r"https?://[^/\s]+(/\S*)?"


@Parameter(name="*")
@dataclass(frozen=True)
class Work:
    """Choose where fits are computed and stored.

    Attributes
    ----------
    output
        Save NAME.json in this folder, not beside the file.
    force
        Fit again even if the folder has the fit already.
    jobs
        Number of fits at once; auto is one for each core of this machine.
    scheduler
        Compute on the Dask cluster with this scheduler, tcp://host:8786.
    url
        Compute on the service at this URL; the environment variable DSBRDF_KEY has the API key.
    """

    output: Annotated[Path | None, Parameter(alias="-o", metavar="DIR")] = None
    force: bool = False
    jobs: CountOrAuto = "auto"
    scheduler: Annotated[str | None, Parameter(metavar="ADDRESS")] = None
    url: Annotated[str | None, Parameter(metavar="URL")] = None

    def __post_init__(self) -> None:
        if self.output is not None and self.output.suffix.lower() in _FILES and not self.output.is_dir():
            raise InvalidArgumentError(
                f"--output: must be a folder, in which NAME.json is saved, not a file such as {self.output}"
            )
        if self.jobs != "auto" and self.jobs < 1:
            raise InvalidArgumentError(f"--jobs: must be at least 1, not {self.jobs}")
        for name, text, address, example in (
            ("--scheduler", self.scheduler, _SCHEDULER, "tcp://host:8786"),
            ("--url", self.url, _URL, "http://127.0.0.1:8000"),
        ):
            if text is not None and re.fullmatch(address, text) is None:
                raise InvalidArgumentError(f"{name}: must be an address such as {example}, not {text!r}")

    def engine(self) -> Engine:
        """Return the engine that computes the fits."""
        jobs = core_count() if self.jobs == "auto" else self.jobs
        if self.url is not None:
            require("client", "httpx", purpose="dsbrdf fit --url")
            found: Engine = entry_point("engines", "url").load()(self.url, jobs)
            return found
        return LocalEngine(jobs) if self.scheduler is None else DaskEngine(self.scheduler, jobs)


_HERE = Work()


@Parameter(name="*", group=Group("Options of the plan", sort_key=4))
@dataclass(frozen=True)
class Plan:
    """Options for the table of directions to measure next.

    Attributes
    ----------
    measure_next
        Write a table of the directions at which further samples would make the fit of a table most certain, with the
        columns of this table; the values are left to fill in.
    next_step
        Smallest step of the instrument; all angles are multiples of it.
    max_theta
        Largest angle to the normal that the instrument reaches.
    """

    measure_next: Annotated[Path | None, Parameter(metavar="FILE")] = None
    next_step: Annotated[float, Parameter(metavar="DEGREES")] = 1.0
    max_theta: Annotated[float, Parameter(metavar="DEGREES")] = 80.0

    def __post_init__(self) -> None:
        if not 0.01 <= self.next_step <= 45.0 or not 10.0 <= self.max_theta <= 90.0:
            raise InvalidArgumentError("--next-step must be from 0.01 to 45, and --max-theta from 10 to 90")

    def write(self, files: Sequence[Path], options: TableOptions, model: DSBRDF) -> None:
        """Write the plan for the samples in the files, with the columns of the first file."""
        if self.measure_next is not None:
            pairs = planned_pairs(read_samples(files, options), model, self.next_step, self.max_theta)
            write_atomically(self.measure_next, [plan_table(files[0].read_bytes(), options, pairs)])


_NO_PLAN = Plan()


def fit(
    *files: RequiredFiles,
    work: Work = _HERE,
    csv: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    plot: bool = False,
    plan: Plan = _NO_PLAN,
    together: Annotated[str | None, Parameter(metavar="NAME")] = None,
    json: Json = False,
    flags: Flags = DEFAULT,
    table: AboutTable = NO_TABLE_FLAGS,
) -> int:
    """Fit the files; return the exit code.

    Parameters
    ----------
    files
        A MERL .binary file, a folder of them, an RGL .bsdf file, or a table of scattered samples, in a text or
        in a spreadsheet.
    csv
        Write the metrics of all files, with the parameters of their components, as one table.
    plot
        Write a figure NAME.png beside each fit.
    together
        Fit all files, tables of one material, as one measurement with this name.
    """
    keep_freed_memory()
    _check_outputs(files, filter(None, (csv, plan.measure_next)), together)
    if together is not None:
        work = replace(work, output=work.output or files[0].parent)
        with TemporaryDirectory() as folder:
            joined = Path(folder) / f"{together}.csv"
            joined.write_bytes(read_samples(files, table.options()).encode())
            if code := fit(joined, work=work, csv=csv, plot=plot, json=json, flags=flags):
                return code
        plan.write(files, table.options(), read_model(Path(work.output or "") / f"{together}.json")[0])
        return 0
    paths = measurement_files(files)
    if plan.measure_next is not None and len(paths) > 1:
        raise InvalidArgumentError("--measure-next is for one table: name one file, or join them with --together")
    if plot:
        require("plot", "matplotlib", purpose="dsbrdf fit --plot")
    done = _fit(paths, flags.options(), table.options(), work, quiet=json)
    if csv is not None:
        write_atomically(csv, [summary_csv(done)])
    if done[0].result is not None:
        plan.write(paths, table.options(), done[0].result.model)
    for path in _plot(done, table.options()) if plot else ():
        if not json:
            print(f"figure: {path}")
    if json:
        documents = [_document(item) for item in done]
        single = len(files) == 1 and not files[0].is_dir()
        print_json(documents[0] if single else {"items": documents})
    elif len(done) > 1 and any(item.result is not None for item in done):
        print("", *summary_table(done), sep="\n")
    if any(item.lost for item in done):
        return 1
    return BAD_INPUT if any(item.error is not None for item in done) else 0


def _check_outputs(files: Sequence[Path], outputs: Iterable[Path], together: str | None) -> None:
    """Raise an error if an output would replace an input, or if the name of a joined measurement has a folder."""
    for output in outputs:
        check_output(output, files)
    if together is not None and (Path(together).name != together or together[:1] in ("", ".")):
        raise InvalidArgumentError(f"--together: must be a name without a folder, not {together!r}")


def _fit(files: list[Path], options: FitOptions, table: TableOptions, work: Work, *, quiet: bool) -> list[FileFit]:
    """Fit the files; print each result when it is ready, unless `quiet`."""
    done: list[FileFit] = []
    bar = _progress_bar()
    task = bar.add_task("", total=len(files), done=0)
    items = fit_files(
        files,
        options,
        work.engine(),
        work.output,
        samples_of=partial(samples_in, options=table),
        force=work.force,
        progress=lambda finished: bar.update(task, completed=finished, done=int(finished)),
    )
    with bar, closing(items):
        for item in items:
            done.append(item)
            messages: tuple[str, ...] = () if item.error is None else (item.error,)
            if item.result is not None and not (quiet or len(files) == 1 or item.resumed):  # Reports have the warnings.
                messages = item.result.report.warnings
            for message in messages:
                _print_above(bar, f"dsbrdf: {item.file}: {message}", error=True)
            for line in [] if quiet else _text(item, whole=len(files) == 1):
                _print_above(bar, line)
            if len(done) < len(files):
                bar.start()
    places = {file: place for place, file in enumerate(files)}
    return sorted(done, key=lambda item: places[item.file])


def _plot(items: list[FileFit], table: TableOptions) -> Iterator[Path]:
    """Write a figure of each fit beside the file of its model, and yield the path of each figure."""
    from dsbrdf.output.figure_panels import encode_figure  # It needs Matplotlib, an extra.
    from dsbrdf.output.plots import plot

    for item in items:
        if item.result is not None and item.output is not None:
            figure = plot(item.result, read_measurement(item.file, table))
            path = item.output.with_suffix(".png")
            write_atomically(path, [encode_figure(figure)])
            yield path


def _text(item: FileFit, *, whole: bool) -> list[str]:
    """Return the report of a fit, whole or in one line, and the name of the saved file."""
    if item.result is None:
        return []
    kept = " (kept)" if item.resumed else ""
    if not whole:
        saved = "" if item.output is None else f" -> {item.output}{kept}"
        return [headline(item.file, item.result) + saved]
    return [*result_text(item.file, item.result), f"saved: {item.output}{kept}"]


def _document(item: FileFit) -> dict[str, Any]:
    """Return the outcome of a fit, with the stored form of the model, which ``dsbrdf eval`` can read."""
    about: dict[str, Any] = {"file": str(item.file), "output": None if item.output is None else str(item.output)}
    if item.result is None:
        return about | {"status": "failed", "error": item.error}
    about |= {"status": "succeeded", "error": None, "resumed": item.resumed}
    return about | result_document(item.result.model, item.result.report)


SHOWN = {"relative_rms": 12, "excess": 8, "psnr": 7}
"""Metrics in the table for the terminal, each with the width of its column; the CSV table has all metrics."""

_OF_FILE = ("file", "status", "error", "n_lobes", "ring_lobes", *METRICS, "seconds", "output", "findings", "warnings")
_COLUMNS = (*COLUMNS[:-1], *_OF_FILE)  # The last name in COLUMNS, psnr, is left out because METRICS has psnr too.


def summary_table(items: Sequence[FileFit]) -> list[str]:
    """Return a table with a line for each fit, the largest error first, and the number of failures."""
    fits = [(item.file, item.result) for item in items if item.result is not None]
    fits.sort(key=lambda pair: pair[1].report.metrics.relative_rms or 0.0, reverse=True)
    heads = "".join(f"{name:>{width}}" for name, width in SHOWN.items())
    lines = [f"{heads}{'lobes':>7}{'warnings':>10}  worst first"]
    for file, result in fits:
        values = [(result.report.metrics[name], width) for name, width in SHOWN.items()]
        cells = "".join(f"{'' if value is None else f'{value:.4g}':>{width}}" for value, width in values)
        lines.append(f"{cells}{result.model.n_lobes:>7}{len(result.report.warnings):>10}  {file.stem}")
    failed = len(items) - len(fits)
    if failed:
        lines.append(f"{failed} {'file' if failed == 1 else 'files'} could not be fitted")
    return lines


def summary_csv(items: Sequence[FileFit]) -> bytes:
    """Return the results of all files as CSV; a file whose fit failed has one row with the error."""
    return table_csv((row for item in items for row in _rows(item)), _COLUMNS)


def _rows(item: FileFit) -> Iterator[dict[str, Any]]:
    if item.result is None:
        yield {"material": item.file.stem, "file": item.file, "status": "failed", "error": item.error}
        return
    model, report = item.result.model, item.result.report
    about = asdict(report.metrics) | {
        "file": item.file,
        "status": "succeeded",
        "n_lobes": model.n_lobes,
        "ring_lobes": int(np.count_nonzero(model.is_ring)),
        "seconds": round(sum(report.timings.values()), 3),
        "output": item.output,
        "findings": " ".join(finding.code for finding in report.findings),
        "warnings": " ".join(report.warnings),
    }
    rows = [*component_rows(item.file.stem, component_documents(item.result), report.metrics.psnr)]
    # A model that reflects nothing has no components, but gets a row.
    for row in rows or [{"material": item.file.stem}]:
        yield row | about


def _progress_bar() -> Progress:
    """Return a progress bar for the number of finished files, which is visible only if stderr is a terminal."""
    return Progress(
        *(BarColumn(), "{task.fields[done]} of {task.total} files", TimeElapsedColumn(), "left", TimeRemainingColumn()),
        console=Console(file=sys.stderr),
        disable=not sys.stderr.isatty(),
        transient=True,
        redirect_stdout=False,
        redirect_stderr=False,
    )


def _print_above(bar: Progress, line: str, *, error: bool = False) -> None:
    """Hide the progress bar, and print a line to stdout or stderr."""
    bar.stop()  # Bar and line may be on different streams of one terminal, where they would overwrite each other.
    print(line, file=sys.stderr if error else sys.stdout, flush=True)
