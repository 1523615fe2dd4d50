"""Fits that tests of several rooms look at, each made once; tests must not change them."""

from collections.abc import Iterator

import pytest

from dsbrdf import FitResult, Measurement, Profiles, fit, profiles
from dsbrdf.model import sampling
from dsbrdf.output.export import glsl, mitsuba
from tests.support.mixtures import COARSE_ANGLES


@pytest.fixture(scope="session")
def plastic_profiles(plastic: Measurement) -> Profiles:
    return profiles(plastic)


@pytest.fixture(scope="session")
def plastic_fit(plastic: Measurement) -> FitResult:
    return fit(plastic)


@pytest.fixture(scope="session")
def two_lobe_fit(plastic: Measurement) -> FitResult:
    """A fit of the plastic that takes a third of the time, with two lobes."""
    return fit(plastic, n_lobes=2, ring_lobes=0)


@pytest.fixture(scope="module")
def coarse_sampling() -> Iterator[None]:
    """Tabulate densities coarsely, for modules with models of their own."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (sampling, glsl, mitsuba):
            patch.setattr(module, "ANGLES", COARSE_ANGLES)
        yield
