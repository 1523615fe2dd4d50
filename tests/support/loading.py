"""Load what a test knows to be the file of a fit."""

from pathlib import Path

import dsbrdf


def load_fit(path: Path) -> dsbrdf.FitResult:
    """Return the fit in a file, which must have a report."""
    found = dsbrdf.load(path)
    assert isinstance(found, dsbrdf.FitResult)
    return found
