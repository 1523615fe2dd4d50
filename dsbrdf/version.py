"""Which algorithm and which software computed a fit."""

import platform
from importlib.metadata import version

__version__ = version("dsbrdf")

ALGORITHM_VERSION = "1"
"""Changes whenever the same measurement and options may give another model: part of a fit's identity."""


def versions() -> dict[str, str]:
    """Return the versions that may make a difference: of the algorithm, this library and what it computes with."""
    return {
        "algorithm": ALGORITHM_VERSION,
        "dsbrdf": __version__,
        "numpy": version("numpy"),
        "scipy": version("scipy"),
        "python": platform.python_version(),
    }
