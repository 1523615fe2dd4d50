"""Zemax's tabular BSDF files (Radiant Imaging's BSDF data interchange format), as tables of samples.

Angles of the receiver are about the mirror direction: ScatterRadial is the angle to it, ScatterAzimuth the turn about
it, 0 towards the normal.
"""

import re
from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import TextTable, check_size
from dsbrdf.samples.names import VECTORS

MAX_HEAD_BYTES = 1 << 16
"""The head of a file of Zemax or LightTools is not longer."""
_LISTS = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
_READ = {"ScatterType": "BRDF", "SpectralContent": "Monochrome"}


def is_zemax(data: bytes) -> bool:
    """Whether a text begins as such a file."""
    head = data[:MAX_HEAD_BYTES]
    return b"ScatterRadial" in head and re.search(rb"(?m)^[ \t]*DataBegin[ \t\r]*$", head) is not None


def zemax_table(data: bytes) -> TextTable:
    """Return the samples of the file as a table; a MeasurementFormatError says what is wrong."""
    split = map(str.split, data.decode("latin-1").splitlines())
    lines = (line for line in split if line and line[0][0] != "#")
    head = list(takewhile(lambda line: line[0] != "DataBegin", lines))
    words = {line[0]: line[1] for line in head if len(line) == 2}
    for name, read in _READ.items():
        if words.get(name, read).lower() != read.lower():
            raise MeasurementFormatError(f"The Zemax BSDF file has {name} {words[name]}; {read} alone is read.")
    _, incidence, azimuth, radial = lists = [numbers_after(name, head) for name in _LISTS]
    if lists[0].size != 1:
        raise MeasurementFormatError("The Zemax BSDF file has several sample rotations; a material here is isotropic.")
    wanted = incidence.size * azimuth.size * radial.size
    check_size(wanted, len(VECTORS) + 1)
    cells = [cell for line in lines if line[0] not in ("TIS", "DataEnd") for cell in line]
    if len(cells) != wanted:
        raise MeasurementFormatError(f"The Zemax BSDF file has {len(cells)} values, and its angles need {wanted}.")
    try:
        values = np.array(cells, dtype=np.float64)
    except ValueError as error:
        raise MeasurementFormatError(f"The Zemax BSDF file has a value that is no number ({error}).") from None
    grid = np.meshgrid(*map(np.radians, (incidence, azimuth, radial)), indexing="ij")
    a, turn, away = (angles.ravel() for angles in grid)
    zero = np.zeros_like(a)
    mirror, to_normal = np.stack([np.sin(a), zero, np.cos(a)]), np.stack([-np.cos(a), zero, np.sin(a)])
    aside = np.stack([zero, zero + 1.0, zero])
    omega_out = np.cos(away) * mirror + np.sin(away) * (np.cos(turn) * to_normal + np.sin(turn) * aside)
    return TextTable.of_numbers((*VECTORS, "value"), [-np.sin(a), zero, np.cos(a), *omega_out, values])


def numbers_after(name: str, head: Sequence[list[str]]) -> Array:
    """Return the numbers after the line with a name and their count, in the lines of a file's head."""
    count = 0
    try:
        at = next(at for at, line in enumerate(head) if line[0] == name)
        count, cells = int(head[at][1]), [*head[at][2:], *(cell for line in head[at + 1 :] for cell in line)]
        numbers = np.array(cells[:count], dtype=np.float64)
    except (StopIteration, IndexError, ValueError):
        numbers = np.zeros(0)
    if numbers.size == 0 or numbers.size != count or not np.isfinite(numbers).all():
        raise MeasurementFormatError(f"The BSDF file has no line {name} with a count, and the angles below it.")
    return numbers
