"""Variants of Mitsuba for tests; where one cannot run, the test is skipped by name."""

import importlib
import importlib.util
from types import ModuleType
from typing import Any

import pytest

_OLDEST_LLVM = (17,)
"""Older ones end the process: they do not know the minimum of two floats that drjit asks for."""


def mitsuba_variant(name: str) -> ModuleType:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip('"mitsuba" is not installed')
    module = importlib.import_module("mitsuba")
    if name.startswith("llvm"):
        try:
            module.set_variant(name)
        except ImportError:
            pytest.skip('"LLVM" is not installed')
        if importlib.import_module("drjit").detail.llvm_version() < _OLDEST_LLVM:
            pytest.skip('"LLVM" is not installed in a version that can be used')
    module.set_variant(name)
    return module


def surface_at(module: ModuleType, wi: Any) -> Any:
    """Return a surface seen from a direction, or from many in an array of shape (3, n)."""
    size = 1 if isinstance(wi, list) else wi.shape[1]
    surface = importlib.import_module("drjit").zeros(module.SurfaceInteraction3f, size)
    surface.wi = module.Vector3f(wi)
    return surface
