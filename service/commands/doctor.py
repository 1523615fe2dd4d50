"""The command ``dsbrdf doctor``: check the installation and the data folder, without changing anything."""

import asyncio
import json
import os
import platform
import shutil
import sqlite3
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from pydantic import ValidationError

import dsbrdf
from dsbrdf.data.synthetic import synthetic_measurement
from dsbrdf.engines.engine import Engine, Fault, FitLimits, FitTask
from dsbrdf.engines.local import LocalEngine
from service.app import make_engine
from service.commands import Parser, data_folder, refuse
from service.errors import CheckFailedError, validation_sentence
from service.settings import Settings
from service.storage.blobs import Blobs
from service.storage.database import FILE_NAME
from service.storage.schema import VERSION

_EXTRAS = {"service": "uvicorn", "client": "httpx", "plot": "matplotlib", "progress": "tqdm", "dask": "distributed"}
_SCHEDULER_TIMEOUT = 10.0  # seconds
_QUICK = dsbrdf.FitOptions(method="paper", n_lobes=1, em_iterations=3)
_SECOND_LOOK_DELAY = 1.0  # seconds


def checks(settings: Settings) -> Iterator[tuple[str, Callable[[], str]]]:
    """Yield names and checks; a check returns what it has found, or raises an exception that says what is wrong."""
    folder = settings.data_dir
    yield "python", _python
    yield "extras", _extras
    yield "data folder", lambda: _writable(folder)
    yield "disk", lambda: _space(folder, settings.min_free_mb)
    if (folder / FILE_NAME).exists():
        yield "database", lambda: _database(folder)
        yield "measurements", lambda: _measurements(folder)
    yield "child process", lambda: asyncio.run(_fit(settings))
    if settings.engine == "dask":
        yield "scheduler", lambda: asyncio.run(_scheduler(make_engine(settings), settings.scheduler))


def _python() -> str:
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]["name"]
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    return (
        f"Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}, BLAS {blas}; "
        f"one BLAS thread in the processes that fit, OMP_NUM_THREADS here: {threads}"
    )


def _extras() -> str:
    installed = [extra for extra, module in _EXTRAS.items() if find_spec(module) is not None]
    missing = [extra for extra in _EXTRAS if extra not in installed]
    rest = f"; not installed: {', '.join(missing)}" if missing else ""
    return f"dsbrdf {dsbrdf.__version__} with {', '.join(installed)}{rest}"


def _writable(folder: Path) -> str:
    if not (folder / "blobs").exists():
        return f"{folder} does not exist yet or is empty; the service makes what it needs"
    Blobs(folder).check()
    return f"{folder} can be written to"


def _space(folder: Path, least_mb: int) -> str:
    existing = next(path for path in (folder, *folder.resolve().parents) if path.exists())
    free = shutil.disk_usage(existing).free >> 20
    if free < least_mb:
        raise CheckFailedError(f"{free} MB are free; the service wants {least_mb} MB: free some, or dsbrdf purge")
    return f"{free} MB are free"


def _database(folder: Path) -> str:
    ((version,),) = _rows(folder, "PRAGMA user_version")
    if version != VERSION:
        raise CheckFailedError(f"schema version {version} is of another release; this one knows {VERSION}")
    faults = [fault for (fault,) in _rows(folder, "PRAGMA integrity_check(3)")]
    if faults != ["ok"]:
        raise CheckFailedError(f"{'; '.join(faults)}: restore the folder from a copy")
    ((fits,),) = _rows(folder, "SELECT count(*) FROM fits")
    return f"intact, schema version {version}, {fits} fits"


def _measurements(folder: Path) -> str:
    """Compare every file with its row; what looks wrong is checked again, as it may be changing at the moment."""
    blobs = Blobs(folder)
    faults = {sha256: fault for sha256 in _stored(folder) if (fault := blobs.damage(sha256))}
    strays = set(blobs.all()) - _stored(folder)
    if faults or strays:
        time.sleep(_SECOND_LOOK_DELAY)
    still = _stored(folder)
    faults = {sha256: fault for sha256, fault in faults.items() if sha256 in still}
    strays = (strays & set(blobs.all())) - still
    if faults:
        sha256, fault = next(iter(faults.items()))
        raise CheckFailedError(
            f"{len(faults)} of {len(still)} files are damaged or missing, first {sha256} ({fault}): upload that "
            "measurement again"
        )
    if strays:
        raise CheckFailedError(
            f"{len(strays)} files have no row, first {min(strays)}: the next start of the service drops them"
        )
    return f"{len(still)} files are what their rows say"


def _stored(folder: Path) -> set[str]:
    return {sha256 for (sha256,) in _rows(folder, "SELECT DISTINCT sha256 FROM measurements")}


def _rows(folder: Path, query: str) -> list[tuple[Any, ...]]:
    """Return what `query` selects from the database, which is opened for reading only."""
    uri = f"{(folder / FILE_NAME).resolve().as_uri()}?mode=ro"
    with closing(sqlite3.connect(uri, uri=True, timeout=10.0)) as db:
        return db.execute(query).fetchall()


async def _fit(settings: Settings) -> str:
    engine = LocalEngine(1, FitLimits(settings.fit_seconds, settings.fit_memory_mb))
    await engine.start()
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "generated.binary"
            dsbrdf.write_merl(path, synthetic_measurement())
            async with engine.slot():
                outcome = await engine.run(FitTask("doctor", path, _QUICK), lambda _: None)
    finally:
        await engine.close()
    if isinstance(outcome, Fault):
        raise CheckFailedError(f"a generated measurement could not be fitted: {outcome.message}")
    return "a generated measurement was fitted in a process of its own"


async def _scheduler(engine: Engine, address: str) -> str:
    await engine.start()
    try:
        deadline = asyncio.get_running_loop().time() + _SCHEDULER_TIMEOUT
        while asyncio.get_running_loop().time() < deadline:
            with suppress(RuntimeError):
                await engine.check()
                break
            await asyncio.sleep(0.2)
        await engine.check()
        return f"{address} answers and has workers"
    finally:
        await engine.close()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = Parser(
        prog="dsbrdf doctor",
        description="Look for what may be wrong with the installation and the service's folder; "
        "a server may run meanwhile.",
    )
    parser.add_data_dir()
    parser.add_json()
    arguments = parser.parse_args(argv)
    try:
        settings = Settings(data_dir=data_folder(arguments))
    except ValidationError as error:
        return refuse(validation_sentence(error.errors()))
    found = []
    for name, check in checks(settings):
        try:
            fine, detail = True, check()
        except (CheckFailedError, OSError, sqlite3.Error, RuntimeError, ImportError) as error:
            fine, detail = False, str(error)
        found.append({"check": name, "fine": fine, "detail": detail})
        if not arguments.json:
            print(f"{'ok' if fine else 'WRONG':<7}{name + ':':<15} {detail}", flush=True)
    if arguments.json:
        print(json.dumps({"items": found}))
    return 0 if all(item["fine"] for item in found) else 1


if __name__ == "__main__":
    sys.exit(main())
