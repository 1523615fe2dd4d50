"""Versions of the library, of its algorithm and of the software that it uses."""

import platform
from importlib.metadata import version

__version__ = version("dsbrdf")

ALGORITHM_VERSION = "2"
"""Changed whenever the same measurement and options may give another model; part of the identity of a fit."""


def versions() -> dict[str, str]:
    """Return all versions that can affect the result of a fit."""
    return {
        "algorithm": ALGORITHM_VERSION,
        "dsbrdf": __version__,
        "numpy": version("numpy"),
        "scipy": version("scipy"),
        "python": platform.python_version(),
    }
