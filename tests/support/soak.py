"""How often tests repeat what asserts the same thing: seldom in ``make test``, and in full in ``make soak``."""

import os

SOAK = os.environ.get("DSBRDF_SOAK") == "1"
"""Whether this is a run of ``make soak``; bars on wall-clock time count only there, where nothing else runs."""


def repeats(usual: int, soak: int) -> int:
    """Return the number of repeats of this run."""
    return soak if SOAK else usual
