"""Fixtures shared by all tests: measurements, clusters and services."""

import ctypes
import fcntl
import gc
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadFileScheduling  # type: ignore[import-untyped]

import examples
from dsbrdf import Measurement, read_merl, write_merl
from dsbrdf.data import read_rgl, synthetic_measurement
from dsbrdf.model import sampling
from dsbrdf.output.export import glsl, mitsuba
from tests.support import launcher
from tests.support.dask_cluster import DaskCluster
from tests.support.merl_files import glossy_plastic
from tests.support.models import COARSE_ANGLES
from tests.support.processes import short_folder
from tests.support.server import Guarded, Server, StartServer, new_key
from tests.support.soak import SOAK

REFERENCE_VARIABLE = "DSBRDF_REFERENCE_DATA"

# A busy machine is no fault of the code under test, and a change is judged by the same examples each time;
# `make soak` looks for others, and for longer.
settings.register_profile(
    "here", deadline=None, suppress_health_check=list(HealthCheck), derandomize=True, max_examples=30
)
settings.register_profile("soak", settings.get_profile("here"), max_examples=10_000, derandomize=False)
settings.load_profile("soak" if SOAK else "here")

gc.disable()  # until all tests are collected: what is imported and collected stays

if sys.platform == "linux" and hasattr(ctypes.CDLL(None), "mallopt"):
    # To give the memory of large arrays back and to get it anew, zeroed, takes a tenth of the time of the tests; so it
    # is kept. The processes that tests start do as they always do.
    for parameter, size in (-3, 1 << 28), (-1, 1 << 30):  # M_MMAP_THRESHOLD and M_TRIM_THRESHOLD of malloc.h
        ctypes.CDLL(None).mallopt(parameter, size)


def pytest_configure(config: pytest.Config) -> None:
    """Start the launcher of services before the workers that share it."""
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        launcher.share()


def pytest_collection_finish() -> None:
    """Look for garbage from now on, but not among modules and tests, again and again."""
    gc.freeze()
    gc.enable()


def scope_of(nodeid: str) -> str:
    """Return the file of a test, or the folder of the page, whose tests share a browser and fits."""
    file = nodeid.partition("::")[0]
    return file.rpartition("/")[0] if "/http/page/" in file else file


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Run the tests of a scope in one process."""
    scheduler = LoadFileScheduling(config, log)
    scheduler._split_scope = scope_of
    return scheduler


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with files that have slow tests, so that the quick ones fill the end of all workers.

    Tests of the service wait half of their time, and those of the library compute: the folders take turns.
    """
    if not SOAK and (left := [item for item in items if item.get_closest_marker("soak")]):
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item not in left]
    slow = {scope_of(item.nodeid) for item in items if item.get_closest_marker("slow")}
    folders = defaultdict[tuple[bool, str], list[str]](list)
    for scope in dict.fromkeys(scope_of(item.nodeid) for item in items):
        folders[scope not in slow, scope.split("/")[1]].append(scope)
    places = {
        scope: (is_quick, place / len(scopes))
        for (is_quick, _), scopes in folders.items()
        for place, scope in enumerate(scopes)
    }
    items.sort(key=lambda item: places[scope_of(item.nodeid)])


Made = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Made:
    """Make a file in the first process of this run that asks for its name; tests must not change it."""
    own = tmp_path_factory.getbasetemp()
    folder = own if worker_id == "master" else own.parent

    def make_unless_there(name: str, make: Callable[[Path], object]) -> Path:
        path = folder / name
        with (folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                make(path)
        return path

    return make_unless_there


@pytest.fixture(scope="session")
def plastic_file(made_once: Made) -> Path:
    """The plastic as a MERL file."""
    return made_once("plastic.binary", lambda path: write_merl(path, glossy_plastic()))


@pytest.fixture(scope="session")
def satin_purple_file(made_once: Made) -> Path:
    """The example as a MERL file: its values at the nodes take a second."""
    example = Path(examples.__file__).with_name("satin_purple.bsdf")
    return made_once("satin_purple.binary", lambda path: write_merl(path, read_rgl(example).measurement()))


@pytest.fixture(scope="session")
def plastic(plastic_file: Path) -> Measurement:
    return read_merl(plastic_file)


@pytest.fixture(scope="module")
def coarse_sampling() -> Iterator[None]:
    """Tabulate densities coarsely, for modules with models of their own."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (sampling, glsl, mitsuba):
            patch.setattr(module, "ANGLES", COARSE_ANGLES)
        yield


@pytest.fixture(scope="session")
def metal() -> Measurement:
    return synthetic_measurement(roughness=0.05, diffuse=(0.0, 0.0, 0.0), specular=(0.95, 0.64, 0.54), name="metal")


@pytest.fixture(scope="session")
def matte() -> Measurement:
    return synthetic_measurement(roughness=0.7, diffuse=(0.6, 0.5, 0.4), specular=(0.02, 0.02, 0.02), name="matte")


@pytest.fixture(scope="session")
def reference_files() -> dict[str, Path]:
    """Measured MERL files by material name; the test is skipped where the variable names no folder of them."""
    folder = os.environ.get(REFERENCE_VARIABLE)
    if not folder:
        pytest.skip(f"{REFERENCE_VARIABLE} is not set: no measured materials to test with")
    files = {path.stem: path for path in sorted(Path(folder).glob("*.binary"))}
    if not files:
        pytest.fail(f"{REFERENCE_VARIABLE} is set to {folder}, which has no .binary files")
    return files


@pytest.fixture(scope="session")
def cluster() -> Iterator[DaskCluster]:
    """A Dask cluster with one worker, to be shared; what breaks it takes one of its own."""
    with short_folder() as folder, closing(DaskCluster(Path(folder))) as running:
        running.start_scheduler()
        running.add_worker()
        yield running


@pytest.fixture
def own_cluster() -> Iterator[DaskCluster]:
    with short_folder() as folder, closing(DaskCluster(Path(folder))) as running:
        yield running


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A service that tests share: they must not rely on what else is in it."""
    with Server.running(tmp_path_factory.mktemp("service") / "data") as running:
        yield running


@pytest.fixture
def own_server(tmp_path: Path) -> Iterator[StartServer]:
    """Start services that one test has for itself, with settings of its own."""
    with ExitStack() as started:
        number = count()

        def start(
            *,
            own_interpreter: bool = False,
            constants: Mapping[str, float] = MappingProxyType({}),
            **environment: str,
        ) -> Server:
            running = started.enter_context(closing(Server(tmp_path / f"data{next(number)}", **environment)))
            running.own_interpreter, running.constants = own_interpreter, constants
            return running.start()

        yield start


@pytest.fixture(scope="session")
def data(plastic_file: Path) -> bytes:
    return plastic_file.read_bytes()


@pytest.fixture(scope="session")
def stored(server: Server, data: bytes) -> str:
    """The sha256 of a measurement that the shared service has."""
    answer = server.http.post("/v1/measurements", content=data)
    assert answer.status_code in (200, 201)
    sha256: str = answer.json()["sha256"]
    return sha256


@pytest.fixture(scope="session")
def fitted(server: Server, stored: str) -> str:
    """The id of a fit with two lobes that has succeeded."""
    answer = server.submit(stored, n_lobes=2, em_iterations=20)
    assert answer.json()["status"] == "succeeded", answer.text
    fit_id: str = answer.json()["id"]
    return fit_id


@pytest.fixture(scope="session")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """A service that wants keys, for tests to share."""
    folder = tmp_path_factory.mktemp("guarded") / "data"
    with Server.running(folder, require_keys="true", workers="2") as running:
        alice, bob = (new_key(running, name)[1] for name in ("alice", "bob"))
        yield Guarded(running, alice, bob)
