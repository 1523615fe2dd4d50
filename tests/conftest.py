"""Fixtures shared by all tests: synthetic measurements, and measured ones where they are at hand."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import write_merl
from dsbrdf.data.synthetic import synthetic_measurement
from tests.dask_cluster import DaskCluster

REFERENCE_VARIABLE = "DSBRDF_REFERENCE_DATA"

# A busy machine is no fault of the code under test, and a change is judged by the same examples each time;
# `pytest --hypothesis-profile=soak` looks for others, and for longer.
settings.register_profile("here", deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
settings.register_profile("soak", settings.get_profile("here"), max_examples=10_000, derandomize=False)
settings.load_profile("here")


def examples(share: float) -> settings:
    """Return settings with a multiple of the number of examples that the profile has."""
    return settings(max_examples=max(1, round(share * settings().max_examples)))


@pytest.fixture(scope="session")
def plastic() -> Measurement:
    """A glossy coloured plastic with 2 % noise."""
    return synthetic_measurement(noise=0.02, seed=1, name="plastic")


@pytest.fixture(scope="session")
def metal() -> Measurement:
    """A polished coloured metal without a diffuse part and without noise."""
    return synthetic_measurement(roughness=0.05, diffuse=(0.0, 0.0, 0.0), specular=(0.95, 0.64, 0.54), name="metal")


@pytest.fixture(scope="session")
def matte() -> Measurement:
    """A rough, nearly diffuse material without noise."""
    return synthetic_measurement(roughness=0.7, diffuse=(0.6, 0.5, 0.4), specular=(0.02, 0.02, 0.02), name="matte")


@pytest.fixture(scope="session")
def measurements(plastic: Measurement, metal: Measurement, matte: Measurement) -> tuple[Measurement, ...]:
    """The three synthetic materials."""
    return plastic, metal, matte


@pytest.fixture(scope="session")
def plastic_file(plastic: Measurement, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plastic as a MERL file; tests must not change it."""
    path = tmp_path_factory.mktemp("measurements") / "plastic.binary"
    write_merl(path, plastic)
    return path


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
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """A Dask cluster with one worker, to be shared; what breaks it takes one of its own."""
    running = DaskCluster(tmp_path_factory.mktemp("cluster"))
    try:
        running.start_scheduler()
        running.add_worker()
        yield running
    finally:
        running.close()


@pytest.fixture
def own_cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    """A cluster to be broken; nothing of it runs yet."""
    running = DaskCluster(tmp_path / "cluster")
    try:
        yield running
    finally:
        running.close()
