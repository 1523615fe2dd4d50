"""Fits that tests of several rooms look at, each made once; tests must not change them."""

from pathlib import Path

import pytest

from dsbrdf import FitResult, Measurement, Profiles, fit, profiles, save
from tests.conftest import Made
from tests.support.command_line import load_fit


@pytest.fixture(scope="session")
def plastic_profiles(plastic: Measurement) -> Profiles:
    return profiles(plastic)


@pytest.fixture(scope="session")
def plastic_fit(plastic: Measurement, made_once: Made) -> FitResult:
    return load_fit(made_once("default.json", lambda path: save(fit(plastic), path)))


@pytest.fixture(scope="session")
def model_file(plastic: Measurement, made_once: Made) -> Path:
    """What ``dsbrdf fit`` stores for the plastic."""
    return made_once("plastic.json", lambda path: save(fit(plastic, n_lobes=2, ring_lobes=0), path))


@pytest.fixture(scope="session")
def two_lobe_fit(model_file: Path) -> FitResult:
    return load_fit(model_file)
