"""Uploads that are no MERL files, checked and made what is stored of them, each in a process of its own.

An RGL file becomes a MERL table, so that all that reads measurements can read it; a table of samples stays as it is.
The process imports nothing of the service.
"""

import hashlib
import os
from pathlib import Path
from typing import Literal, NamedTuple

from dsbrdf.data.merl import encode_merl
from dsbrdf.data.rgl_material import read_rgl
from dsbrdf.data.scattered_samples import parse_samples
from dsbrdf.engines.engine import OnProgress

Kind = Literal["rgl", "samples"]


class Converted(NamedTuple):
    """What is stored: the digest and the length of the file, and the grid nodes with a value, 0 of samples."""

    sha256: str
    size: int
    valid_nodes: int


def conversion_step(path: Path, kind: Kind, _: OnProgress) -> Converted:
    """Check a file, and replace its content by what is stored; raise MeasurementFormatError if it is wrong."""
    if kind == "samples":
        content, valid_nodes = path.read_bytes(), 0
        parse_samples(content)
    else:
        measurement = read_rgl(path).measurement()
        content, valid_nodes = encode_merl(measurement), int(measurement.valid.sum())
        with path.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    return Converted(hashlib.sha256(content).hexdigest(), len(content), valid_nodes)
