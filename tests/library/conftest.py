"""Fits that tests of several rooms look at, each made once; tests must not change them."""

import fcntl
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dsbrdf import FitResult, Measurement, Profiles, fit, profiles, save
from dsbrdf.model import sampling
from dsbrdf.output.export import glsl, mitsuba
from tests.support.command_line import load_fit
from tests.support.models import COARSE_ANGLES


@pytest.fixture(scope="session")
def plastic_profiles(plastic: Measurement) -> Profiles:
    return profiles(plastic)


def fitted_once(path: Path, measurement: Measurement, **options: Any) -> FitResult:
    """Fit in the first worker that asks; the others read its file."""
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            save(fit(measurement, **options), path)
    return load_fit(path)


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    own = tmp_path_factory.getbasetemp()
    return own if worker_id == "master" else own.parent


@pytest.fixture(scope="session")
def plastic_fit(plastic: Measurement, shared_folder: Path) -> FitResult:
    return fitted_once(shared_folder / "default.json", plastic)


@pytest.fixture(scope="session")
def two_lobe_fit(plastic: Measurement, shared_folder: Path) -> FitResult:
    return fitted_once(shared_folder / "two_lobes.json", plastic, n_lobes=2, ring_lobes=0)


@pytest.fixture(scope="module")
def coarse_sampling() -> Iterator[None]:
    """Tabulate densities coarsely, for modules with models of their own."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (sampling, glsl, mitsuba):
            patch.setattr(module, "ANGLES", COARSE_ANGLES)
        yield


@pytest.fixture(scope="session")
def model_file(two_lobe_fit: FitResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``dsbrdf fit`` stores for the plastic; tests must not change it."""
    path = tmp_path_factory.mktemp("models") / "plastic.json"
    save(two_lobe_fit, path)
    return path
