"""Fits that tests of several rooms look at, each made once; tests must not change them."""

import pytest

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitResult


@pytest.fixture(scope="session")
def plastic_profiles(plastic: Measurement) -> Profiles:
    """The plastic's profiles with the default options."""
    return profiles(plastic)


@pytest.fixture(scope="session")
def plastic_fit(plastic: Measurement) -> FitResult:
    """The default fit of the plastic."""
    return fit(plastic)


@pytest.fixture(scope="session")
def two_lobe_fit(plastic: Measurement) -> FitResult:
    """A fit of the plastic that takes a third of the time, with two lobes."""
    return fit(plastic, n_lobes=2, ring_lobes=0)


@pytest.fixture(scope="session")
def default_fits(plastic_fit: FitResult, metal: Measurement, matte: Measurement) -> tuple[FitResult, ...]:
    """The default fits of the three synthetic materials."""
    return plastic_fit, fit(metal), fit(matte)
