"""How often tests repeat what asserts the same thing: seldom in ``make test``, and in full in ``make soak``."""

import os

from hypothesis import settings

SOAK = os.environ.get("DSBRDF_SOAK") == "1"
"""Whether this is a run of ``make soak``; bars on wall-clock time count only there, where nothing else runs."""


def repeats(usual: int, soak: int) -> int:
    return soak if SOAK else usual


def examples(share: float) -> settings:
    """Return settings with a multiple of the number of examples that the profile has."""
    return settings(max_examples=max(1, round(share * settings().max_examples)))
