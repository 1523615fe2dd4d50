"""Define the versions of the library, of its algorithm and of the software that it uses."""

import platform
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version

__version__ = version("dsbrdf")

ALGORITHM_VERSION = "11"
"""Changes whenever equal measurements and options may result in another model; part of the identity of a fit."""


@dataclass(frozen=True)
class Versions:
    """All versions that can affect the result of a fit."""

    algorithm: str
    dsbrdf: str
    numpy: str
    scipy: str
    python: str


@cache
def versions() -> Versions:
    """Return the versions of this process."""
    return Versions(
        algorithm=ALGORITHM_VERSION,
        dsbrdf=__version__,
        numpy=version("numpy"),
        scipy=version("scipy"),
        python=platform.python_version(),
    )
