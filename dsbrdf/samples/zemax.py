"""Zemax's tabular BSDF files (Radiant Imaging's BSDF data interchange format), as tables of samples.

Angles of the receiver are about the mirror direction: ScatterRadial is the angle to it, ScatterAzimuth the turn about
it, 0 towards the normal.
"""

import os
import re
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.text_table import TextTable, check_size

_LONGEST_HEAD = 1 << 16  # [bytes]
_LISTS = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
_READ = {"ScatterType": "BRDF", "SpectralContent": "Monochrome"}
_NAMES = ("omega_in_x", "omega_in_y", "omega_in_z", "omega_out_x", "omega_out_y", "omega_out_z", "value")


def is_zemax(data: bytes) -> bool:
    """Whether a text begins as such a file."""
    head = data[:_LONGEST_HEAD]
    return b"ScatterRadial" in head and re.search(rb"(?m)^[ \t]*DataBegin[ \t\r]*$", head) is not None


def begins_as_zemax(path: str | os.PathLike[str]) -> bool:
    """Whether a path names such a file."""
    if not Path(path).is_file():
        return False
    with Path(path).open("rb") as file:
        return is_zemax(file.read(_LONGEST_HEAD))


def zemax_table(data: bytes) -> TextTable:
    """Return the samples of the file as a table; a MeasurementFormatError says what is wrong."""
    split = enumerate(map(str.split, data.decode("latin-1").splitlines()), 1)
    lines = ((at, line) for at, line in split if line and line[0][0] != "#")
    head = [line for _, line in takewhile(lambda numbered: numbered[1][0] != "DataBegin", lines)]
    words = {line[0]: line[1] for line in head if len(line) == 2}
    for name, read in _READ.items():
        if words.get(name, read).lower() != read.lower():
            raise MeasurementFormatError(f"The Zemax BSDF file has {name} {words[name]}; {read} alone is read.")
    _, incidence, azimuth, radial = lists = [_numbers(name, head) for name in _LISTS]
    if lists[0].size != 1:
        raise MeasurementFormatError("The Zemax BSDF file has several sample rotations; a material here is isotropic.")
    wanted = incidence.size * azimuth.size * radial.size
    check_size(wanted, len(_NAMES))
    cells = [(cell, at) for at, line in lines if line[0] not in ("TIS", "DataEnd") for cell in line]
    if len(cells) != wanted:
        raise MeasurementFormatError(f"The Zemax BSDF file has {len(cells)} values, and its angles need {wanted}.")
    grid = np.meshgrid(*map(np.radians, (incidence, azimuth, radial)), indexing="ij")
    a, turn, away = (angles.ravel() for angles in grid)
    zero = np.zeros_like(a)
    omega_in = np.stack([-np.sin(a), zero, np.cos(a)], axis=-1)
    mirror, to_normal = np.stack([np.sin(a), zero, np.cos(a)]), np.stack([-np.cos(a), zero, np.sin(a)])
    aside = np.stack([zero, zero + 1.0, zero])
    omega_out = (np.cos(away) * mirror + np.sin(away) * (np.cos(turn) * to_normal + np.sin(turn) * aside)).T
    directions = np.hstack([omega_in, omega_out]).tolist()
    rows = [[*map(repr, pair), cell] for pair, (cell, _) in zip(directions, cells, strict=True)]
    return TextTable(_NAMES, ("",) * len(_NAMES), rows, [number for _, number in cells], " ")


def _numbers(name: str, head: Sequence[list[str]]) -> Array:
    """Return the numbers after the line with a name and their count."""
    count = 0
    try:
        at = next(at for at, line in enumerate(head) if line[0] == name)
        count, cells = int(head[at][1]), [cell for line in head[at + 1 :] for cell in line]
        numbers = np.array(cells[:count], dtype=np.float64)
    except (StopIteration, IndexError, ValueError):
        numbers = np.zeros(0)
    if numbers.size == 0 or numbers.size != count or not np.isfinite(numbers).all():
        raise MeasurementFormatError(f"The Zemax BSDF file has no line {name} with a count, and the angles below it.")
    return numbers
