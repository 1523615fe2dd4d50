"""The command ``dsbrdf fit``."""

import argparse
import re
from contextlib import closing
from pathlib import Path
from typing import Any

from dsbrdf.cli.arguments import BAD_INPUT, add_json_option, print_json, whole_number
from dsbrdf.cli.fit_arguments import add_fit_options, fit_options
from dsbrdf.cli.progress import progress_bar
from dsbrdf.engines.batch import FileFit, fit_files, measurement_files
from dsbrdf.output.report_text import headline, result_document, result_text
from dsbrdf.process_settings import keep_freed_memory


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
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="write NAME.json into this folder")
    parser.add_argument("--jobs", type=whole_number, metavar="N", help="fits at once (default: one for each core)")
    parser.add_argument(
        "--scheduler",
        type=_scheduler_address,
        metavar="ADDRESS",
        help="compute on the Dask cluster with this scheduler (tcp://host:8786)",
    )
    parser.add_argument("--force", action="store_true", help="fit again even if the folder has the fit already")
    add_json_option(parser)
    add_fit_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Fit the files; return the exit code."""
    keep_freed_memory()
    options = fit_options(arguments)
    files = measurement_files(arguments.files)
    done: list[FileFit] = []
    with (
        progress_bar(len(files), "files") as progress,
        closing(
            fit_files(
                files,
                options,
                arguments.output,
                jobs=arguments.jobs,
                scheduler=arguments.scheduler,
                force=arguments.force,
                progress=progress,
            )
        ) as items,
    ):
        for item in items:
            done.append(item)
            for message in _messages(item, as_json=arguments.json):
                progress.write(f"dsbrdf: {item.file}: {message}", error=True)
            if not arguments.json:
                for line in _text(item):
                    progress.write(line)
    if arguments.json:
        documents = [_document(item) for item in done]
        single = len(arguments.files) == 1 and not arguments.files[0].is_dir()
        print_json(documents[0] if single else {"items": documents})
    if any(item.lost for item in done):
        return 1
    return BAD_INPUT if any(item.error is not None for item in done) else 0


def _scheduler_address(text: str) -> str:
    """Argument type: the address of a Dask scheduler."""
    if re.fullmatch(r"(tcp|tls|ws|wss)://[^/\s]+:[0-9]+", text) is None:
        raise argparse.ArgumentTypeError(f"must be an address such as tcp://host:8786, not {text!r}")
    return text


def _messages(item: FileFit, *, as_json: bool) -> tuple[str, ...]:
    """Return what stderr shows of a file: its error, or the warnings of a new fit where nothing on stdout has them."""
    if item.result is None:
        return () if item.error is None else (item.error,)
    printed = as_json or item.output is None or item.resumed
    return () if printed else item.result.report.warnings


def _text(item: FileFit) -> list[str]:
    """Return the lines to print: a whole report, or one line if the model was written to a file."""
    if item.result is None:
        return []
    if item.output is None:
        return result_text(item.file, item.result)
    return [f"{headline(item.file, item.result)} -> {item.output}{' (kept)' if item.resumed else ''}"]


def _document(item: FileFit) -> dict[str, Any]:
    """Return the stored form of the model, which ``dsbrdf eval`` can read, with the result of the fit beside it."""
    about: dict[str, Any] = {"file": str(item.file), "output": None if item.output is None else str(item.output)}
    if item.result is None:
        return about | {"status": "failed", "error": item.error}
    about |= {"status": "succeeded", "error": None, "resumed": item.resumed}
    return about | result_document(item.result.model, item.result.report)
