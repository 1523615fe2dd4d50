"""Files of measurements of any kind; the suffix tells which."""

import os
from pathlib import Path

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import read_merl
from dsbrdf.data.rgl_material import read_rgl
from dsbrdf.data.sample_tables import TABLE_SUFFIXES, read_samples
from dsbrdf.data.scattered_samples import ScatteredSamples


def read_measurement(path: str | os.PathLike[str]) -> Measurement | ScatteredSamples:
    """Read a measured material.

    Parameters
    ----------
    path : path-like
        ``.bsdf`` is an RGL file, whose values are taken at the nodes of the MERL grid; ``.csv``, ``.tsv`` and
        ``.txt`` are tables of scattered samples; any other file is a MERL ``.binary`` file.

    Returns
    -------
    Measurement or ScatteredSamples

    Raises
    ------
    MeasurementFormatError
        With one sentence that says what is wrong and what would be right.
    OSError
        If the file does not exist or cannot be read.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".bsdf":
        return read_rgl(path).measurement()
    return read_samples(path) if suffix in TABLE_SUFFIXES else read_merl(path)
