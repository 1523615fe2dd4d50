"""Fits that tests of several rooms look at, each made once; tests must not change them."""

from collections.abc import Iterator

import pytest

from dsbrdf import FitResult, Measurement, Profiles, fit, profiles
from dsbrdf.model import sampling
from dsbrdf.output.export import glsl, mitsuba


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


@pytest.fixture(scope="module")
def coarse_sampling() -> Iterator[None]:
    """A table of densities for every 15th degree instead of 1.5, which a model makes before it draws a direction.

    For modules with models of their own: a table does not go with another number of angles.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module in (sampling, glsl, mitsuba):
            patch.setattr(module, "ANGLES", module.ANGLES[::10])
        yield
