"""Load fits of measured materials that come with the package: an atlas to try everything on.

The README of this folder names the origin of the measurements. ``python -m benchmarks atlas`` makes the fits again.
"""

from pathlib import Path

from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.output.serialize import result_from_json
from dsbrdf.result import FitResult

FOLDER = Path(__file__).parent


def materials() -> tuple[str, ...]:
    """Return the names of the measured materials whose fits come with the package, in alphabetical order."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.json")))


def load_material(name: str) -> FitResult:
    """Return the fit of a measured material that comes with the package.

    Parameters
    ----------
    name : str
        One of `materials`, such as ``aurora_white``.

    Returns
    -------
    FitResult
        The model and the report of its fit; the parameters are rounded to 7 digits.

    Raises
    ------
    InvalidArgumentError
        If there is no such material.
    """
    if name not in materials():
        raise InvalidArgumentError(f"there is no material {name!r}; a material is {one_of(list(materials()))}")
    return result_from_json((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
