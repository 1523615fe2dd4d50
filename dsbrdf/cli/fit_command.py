"""The command ``dsbrdf fit``."""

import argparse
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from dsbrdf.cli.arguments import BAD_INPUT, add_json_option, print_json, whole_number
from dsbrdf.cli.fit_arguments import add_fit_options, fit_options
from dsbrdf.cli.fit_summary import summary_csv, summary_table
from dsbrdf.cli.progress import progress_bar
from dsbrdf.cli.server_engine import ServerEngine
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.measurement_files import read_measurement
from dsbrdf.engines.batch import FileFit, fit_files, measurement_files
from dsbrdf.extras import require
from dsbrdf.fitting.options import FitOptions
from dsbrdf.output.report_text import headline, result_document, result_text
from dsbrdf.process_settings import core_count, keep_freed_memory


def configure(parser: argparse.ArgumentParser, _: str) -> None:
    """Add the arguments of the command to its parser."""
    parser.set_defaults(run=run)
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="a MERL .binary file, a folder of them, an RGL .bsdf file, or a .csv table of scattered samples",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="save NAME.json in this folder")
    parser.add_argument("--jobs", type=whole_number, metavar="N", help="fits at once (default: one for each core)")
    parser.add_argument(
        "--scheduler",
        type=_scheduler_address,
        metavar="ADDRESS",
        help="compute on the Dask cluster with this scheduler (tcp://host:8786)",
    )
    parser.add_argument(
        "--url", type=_url, metavar="URL", help="compute on the service there; DSBRDF_KEY in the environment is the key"
    )
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the metrics of all files as a table")
    parser.add_argument(
        "--plot", action="store_true", help="write a figure NAME.png of each fit into the folder, or here without one"
    )
    parser.add_argument("--force", action="store_true", help="fit again even if the folder has the fit already")
    add_json_option(parser)
    add_fit_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Fit the files; return the exit code."""
    keep_freed_memory()
    options = fit_options(arguments)
    files = measurement_files(arguments.files)
    if arguments.plot:
        require("plot", "matplotlib", purpose="dsbrdf fit --plot")
    done = _fit(files, options, arguments)
    if arguments.csv is not None:
        write_atomically(arguments.csv, [summary_csv(done)])
    if arguments.plot:
        for line in _plot(done, arguments.output or Path()):
            if not arguments.json:
                print(line)
    if arguments.json:
        documents = [_document(item) for item in done]
        single = len(arguments.files) == 1 and not arguments.files[0].is_dir()
        print_json(documents[0] if single else {"items": documents})
    elif len(done) > 1 and any(item.result is not None for item in done):
        print("", *summary_table(done), sep="\n")
    if any(item.lost for item in done):
        return 1
    return BAD_INPUT if any(item.error is not None for item in done) else 0


def _fit(files: list[Path], options: FitOptions, arguments: argparse.Namespace) -> list[FileFit]:
    """Fit the files, and print each result as soon as it is there."""
    done: list[FileFit] = []
    jobs = core_count() if arguments.jobs is None else arguments.jobs
    with (
        progress_bar(len(files), "files") as progress,
        closing(
            fit_files(
                files,
                options,
                arguments.output,
                jobs=jobs,
                scheduler=arguments.scheduler,
                engine=None if arguments.url is None else ServerEngine(arguments.url, jobs),
                force=arguments.force,
                progress=progress,
            )
        ) as items,
    ):
        for item in items:
            done.append(item)
            for message in _messages(item, printed=arguments.json or len(files) == 1):
                progress.write(f"dsbrdf: {item.file}: {message}", error=True)
            if not arguments.json:
                for line in _text(item, whole=len(files) == 1):
                    progress.write(line)
    return done


def _plot(items: list[FileFit], folder: Path) -> Iterator[str]:
    """Write a figure of each fit into a folder, and yield what to print."""
    from dsbrdf.output.figures import encode_figure
    from dsbrdf.output.notebook import plot_result

    for item in items:
        if item.result is not None:
            measurement = read_measurement(item.file)
            figure = plot_result(item.result, measurement if isinstance(measurement, Measurement) else None)
            path = folder / f"{item.file.stem}.png"
            write_atomically(path, [encode_figure(figure)])
            yield f"figure: {path}"


def _scheduler_address(text: str) -> str:
    """Argument type: the address of a Dask scheduler."""
    if re.fullmatch(r"(tcp|tls|ws|wss)://[^/\s]+:[0-9]+", text) is None:
        raise argparse.ArgumentTypeError(f"must be an address such as tcp://host:8786, not {text!r}")
    return text


def _url(text: str) -> str:
    """Argument type: the address of a service."""
    if re.fullmatch(r"https?://[^/\s]+(/\S*)?", text) is None:
        raise argparse.ArgumentTypeError(f"must be an address such as http://127.0.0.1:8000, not {text!r}")
    return text


def _messages(item: FileFit, *, printed: bool) -> tuple[str, ...]:
    """Return what stderr shows of a file: its error, or the warnings of a new fit where stdout has no report."""
    if item.result is None:
        return () if item.error is None else (item.error,)
    return () if printed or item.resumed else item.result.report.warnings


def _text(item: FileFit, *, whole: bool) -> list[str]:
    """Return the lines to print: the whole report or one line, and where the model was saved."""
    if item.result is None:
        return []
    kept = " (kept)" if item.resumed else ""
    if not whole:
        saved = "" if item.output is None else f" -> {item.output}{kept}"
        return [headline(item.file, item.result) + saved]
    saved_line = [] if item.output is None else [f"saved: {item.output}{kept}"]
    return [*result_text(item.file, item.result), *saved_line]


def _document(item: FileFit) -> dict[str, Any]:
    """Return the stored form of the model, which ``dsbrdf eval`` can read, with the result of the fit beside it."""
    about: dict[str, Any] = {"file": str(item.file), "output": None if item.output is None else str(item.output)}
    if item.result is None:
        return about | {"status": "failed", "error": item.error}
    about |= {"status": "succeeded", "error": None, "resumed": item.resumed}
    return about | result_document(item.result.model, item.result.report)
