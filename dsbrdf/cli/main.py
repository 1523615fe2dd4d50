"""The command ``dsbrdf``.

Angles are in degrees here, BRDF values in 1/sr, colours in the order red, green, blue.  Exit codes: 0 fine;
2 bad usage or bad input, with one sentence on stderr; 1 anything else; 130 interrupted.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

import dsbrdf
from dsbrdf.cli.fit_arguments import add_fit_flags, fit_options, scheduler_address, whole_number
from dsbrdf.cli.point_arguments import add_point_flags, given_points, join_directions
from dsbrdf.cli.progress import progress_bar
from dsbrdf.cli.service_commands import add_service_commands
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.grid import CHANNELS
from dsbrdf.engines.batch import UNREADABLE, FileFit, fit_files, measurement_files
from dsbrdf.errors import DSBRDFError
from dsbrdf.extras import MissingExtraError, require
from dsbrdf.fitting.report import FitReport
from dsbrdf.model.decomposition import LABELS, decompose
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import FORMATS, export_model
from dsbrdf.output.report_text import (
    component_documents,
    components_table,
    headline,
    lobes_document,
    parameters_table,
    result_text,
)
from dsbrdf.output.serialize import from_json, from_npz, load, to_json

BAD_INPUT = 2
INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv : sequence of str, optional
        The words after ``dsbrdf``; by default those of the process.

    Returns
    -------
    int
        The exit code.
    """
    arguments = _parser().parse_args(join_directions(sys.argv[1:] if argv is None else argv))
    try:
        code: int = arguments.run(arguments)
        sys.stdout.flush()
    except (DSBRDFError, *UNREADABLE) as error:
        return _complain(error, BAD_INPUT)
    except BrokenPipeError:
        # The reader has left, as `head` does: nothing to tell, and nothing to flush at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (MissingExtraError, OSError) as error:
        return _complain(error, 1)
    except KeyboardInterrupt:
        return _complain("interrupted", INTERRUPTED)
    return code


def _fit(arguments: argparse.Namespace) -> int:
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
            for line in (item.error, *item.warnings):
                if line is not None:
                    progress.write(f"dsbrdf: {item.file}: {line}", error=True)
            if not arguments.json:
                for line in _fit_lines(item):
                    progress.write(line)
    if arguments.json:
        documents = [_fit_document(item) for item in done]
        single = len(arguments.files) == 1 and not arguments.files[0].is_dir()
        _print_json(documents[0] if single else {"items": documents})
    if any(item.lost for item in done):
        return 1
    return BAD_INPUT if any(item.error is not None for item in done) else 0


def _fit_lines(item: FileFit) -> list[str]:
    if item.result is None:
        return []
    if item.output is None:
        return result_text(item.file, item.result)
    return [f"{headline(item.file, item.result)} -> {item.output}{' (kept)' if item.resumed else ''}"]


def _fit_document(item: FileFit) -> dict[str, Any]:
    """Return the stored form of the model, which ``dsbrdf eval`` can read, and what happened beside it."""
    about = {"file": str(item.file), "output": None if item.output is None else str(item.output)}
    if item.result is None:
        return about | {"status": "failed", "error": item.error}
    result = item.result
    return (
        about
        | {"status": "succeeded", "error": None, "resumed": item.resumed, "warnings": list(item.warnings)}
        | {"metrics": result.report.metrics, "lobes": lobes_document(result.model)}
        | {"components": component_documents(result.model)}
        | json.loads(to_json(result.model, result.report))
    )


def _eval(arguments: argparse.Namespace) -> int:
    model = _load(arguments.model, arguments.component)
    points = given_points(arguments)
    if "omega_in" in points:
        values = model.evaluate_directions(points["omega_in"], points["omega_out"])
    else:
        values = model.evaluate(*(np.radians(angles) for angles in points.values()))
    if arguments.json:
        _print_json({name: array.tolist() for name, array in points.items()} | {"values": values.tolist()})
        return 0
    print("".join(f"{name:>24}" for name in points) + "".join(f"{channel:>14}" for channel in CHANNELS))
    for *point, value in zip(*points.values(), values, strict=True):
        left = "".join(f"{','.join(f'{number:.6g}' for number in np.ravel(part)):>24}" for part in point)
        print(left + "".join(f"{number:>14.6g}" for number in value))
    return 0


def _decompose(arguments: argparse.Namespace) -> int:
    model = _load(arguments.model)
    components = component_documents(model)
    if arguments.json:
        _print_json({"items": components})
        return 0
    for line in (*components_table(components), "", *parameters_table(model, channel=arguments.channel)):
        print(line)
    return 0


def _export(arguments: argparse.Namespace) -> int:
    model = _load(arguments.model, arguments.component)
    report = _report(arguments.model) if arguments.component is None else None
    content = export_model(model, arguments.format, report)
    write_atomically(arguments.output, [content])
    if arguments.json:
        _print_json({"output": str(arguments.output), "format": arguments.format, "bytes": len(content)})
    return 0


def _serve(arguments: argparse.Namespace) -> int:
    require("service", "fastapi", "pydantic_settings", "uvicorn", purpose="the HTTP service")
    command = [sys.executable, "-m", "service"]
    for name in ("host", "port", "data_dir", "workers"):
        value = getattr(arguments, name)
        if value is not None:
            command += [f"--{name.replace('_', '-')}", str(value)]
    command += ["--insecure"] if arguments.insecure else []
    sys.stdout.flush()
    os.execv(sys.executable, command)  # noqa: S606 (the service takes the place of this process, so signals reach it)


def _demo(arguments: argparse.Namespace) -> int:
    from dsbrdf.cli.demo import run

    run(arguments.output)
    return 0


def _load(path: Path, component: str | None = None) -> DSBRDF:
    """Read a model, or one component of it; errors name the file."""
    with _about(path):
        model = load(path)
    return model if component is None else decompose(model)[component]


def _report(path: Path) -> FitReport | None:
    """Read the report beside a model that `_load` has accepted."""
    if path.suffix.lower() == ".npz":
        return from_npz(path.read_bytes())[1]
    return from_json(path.read_text(encoding="utf-8"))[1]


@contextmanager
def _about(path: Path) -> Iterator[None]:
    """Put the file's name before the sentence of an error."""
    try:
        yield
    except DSBRDFError as error:
        raise type(error)(f"{path}: {error}") from error


def _complain(error: BaseException | str, code: int) -> int:
    if isinstance(error, OSError):
        text = f"{error.filename}: {error.strerror}" if error.filename is not None else str(error)
    else:
        text = str(error)
    print(f"dsbrdf: {text}", file=sys.stderr)
    return code


def _print_json(document: Any) -> None:
    print(json.dumps(document, allow_nan=False))


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one sentence instead of printing the whole usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="dsbrdf", description="Directional Statistics BRDF models of measured reflectance.")
    parser.add_argument("--version", action="version", version=f"dsbrdf {dsbrdf.__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_fit(commands)
    _add_model_commands(commands)
    _add_serve_and_demo(commands)
    add_service_commands(commands)
    return parser


def _add_fit(commands: "argparse._SubParsersAction[_Parser]") -> None:
    fit = commands.add_parser("fit", help="fit models to MERL .binary files")
    fit.set_defaults(run=_fit)
    fit.add_argument("files", nargs="+", type=Path, metavar="FILE", help="a MERL .binary file, or a folder of them")
    fit.add_argument("-o", "--output", type=Path, metavar="DIR", help="write NAME.json into this folder")
    fit.add_argument("--jobs", type=whole_number, metavar="N", help="fits that run at once (default: one for each CPU)")
    fit.add_argument(
        "--scheduler",
        type=scheduler_address,
        metavar="ADDRESS",
        help="fit on the Dask cluster of this scheduler (tcp://host:8786)",
    )
    fit.add_argument("--force", action="store_true", help="fit again what the folder holds already")
    fit.add_argument("--json", action="store_true", help="print one JSON document instead of text")
    add_fit_flags(fit)


def _add_model_commands(commands: "argparse._SubParsersAction[_Parser]") -> None:
    evaluate = commands.add_parser("eval", help="print values of a model")
    evaluate.set_defaults(run=_eval)
    add_point_flags(evaluate)

    separate = commands.add_parser("decompose", help="print the specular spike, specular lobe and diffuse part")
    separate.set_defaults(run=_decompose)
    separate.add_argument("--channel", choices=CHANNELS, default="red", help="whose parameters the text shows")

    export = commands.add_parser("export", help="write a model for other programs")
    export.set_defaults(run=_export)
    export.add_argument("--format", choices=FORMATS, required=True, help="merl is a table of values")
    export.add_argument("-o", "--output", type=Path, required=True, metavar="OUT", help="the file to write")

    for command in (evaluate, separate, export):
        command.add_argument("model", type=Path, metavar="MODEL", help="a .json or .npz file from dsbrdf fit")
        command.add_argument("--json", action="store_true", help="print one JSON document instead of text")
    for command in (evaluate, export):
        command.add_argument("--component", choices=LABELS, help="one component instead of the whole model")


def _add_serve_and_demo(commands: "argparse._SubParsersAction[_Parser]") -> None:
    serve = commands.add_parser("serve", help="run the HTTP service")
    serve.set_defaults(run=_serve)
    serve.add_argument("--host", help="address to listen on (default: 127.0.0.1)")
    serve.add_argument("--port", type=whole_number, metavar="N", help="port to listen on (default: 8000)")
    serve.add_argument(
        "--data-dir", metavar="DIR", help="folder of the database and the measurements (default: dsbrdf-data)"
    )
    serve.add_argument("--workers", type=whole_number, metavar="N", help="fits at once (default: one for each core)")
    serve.add_argument("--insecure", action="store_true", help="allow an address other than loopback without API keys")

    demo = commands.add_parser("demo", help="start the service, fit a generated measurement, leave a picture")
    demo.set_defaults(run=_demo)
    demo.add_argument(
        "-o", "--output", type=Path, default=Path("out"), metavar="DIR", help="folder of the picture (default: out)"
    )


if __name__ == "__main__":
    sys.exit(main())
