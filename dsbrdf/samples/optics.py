"""Read files of samples for programs of optical design: Zemax, LightTools, FRED and Speos.

Sources: Zemax' tabular BSDF (Radiant Imaging's BSDF data interchange format), LightTools' BSDF text (read by libbsdf,
LightToolsBsdfReader), FRED's tabulated BSDF (Photon Engineering, FRED help, "Tabulated BSDF"; written by
ua-loft/bsdf-tools), and Speos' BRDF file (Ansys help, "Structure of BRDF files"; written by Ansys' BSDF converter).
"""

import re
from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import TextTable, check_size, decoded
from dsbrdf.samples.names import VECTORS
from dsbrdf.samples.text_table import rows_of, unnamed_table

_HEAD_BYTES = 1 << 16  # The head of a Zemax or LightTools file has fewer bytes.
_ZEMAX_LISTS = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
_ZEMAX_WORDS = {"ScatterType": "BRDF", "SpectralContent": "Monochrome"}
_LIGHTTOOLS_BLOCK = re.compile(r"((?:^[ \t]*[A-Za-z]\w*[ \t]+\S+[ \t\r]*\n)+)([-+0-9.eE\s]*)", re.MULTILINE)
# The possessive *+ prevents backtracking, which would be slow for a file of many blank lines.
_FRED = re.compile(rb"\A(?:[ \t]*(?:[#!].*)?\r?\n)*+[ \t]*(?:type\s+)?bsdf_data\b")
_SPEOS = b"OPTIS - brdf surface file"
# Column names of the tables that this module reads; a block is a part of a file with one angle of incidence.
_NAMES = ("theta_out", "phi_out", "value", "theta_in", "phi_in", "wavelength")


def scatter_table(data: bytes) -> TextTable | None:
    """Return the samples of a BSDF file of Zemax or LightTools, recognised by the word ScatterRadial in its head."""
    head = data[:_HEAD_BYTES]
    if b"ScatterRadial" not in head:
        return None
    if re.search(rb"(?m)^[ \t]*AOI[ \t]+[-+0-9.]", head):
        return _lighttools_table(data.decode("latin-1"))
    return _zemax_table(data.decode("latin-1")) if re.search(rb"(?m)^[ \t]*DataBegin[ \t\r]*$", head) else None


def _zemax_table(text: str) -> TextTable:
    """Return the samples of a Zemax file, whose viewing angles are relative to the mirror direction.

    ScatterRadial is the angle to the mirror direction; ScatterAzimuth is the rotation about the mirror direction, 0
    towards the normal.
    """
    lines = _words(text)
    begin = next(at for at, line in enumerate(lines) if line[0] == "DataBegin")
    words = {line[0]: line[1] for line in lines[:begin] if len(line) == 2}
    for name, read in _ZEMAX_WORDS.items():
        if words.get(name, read).lower() != read.lower():
            raise MeasurementFormatError(f"The Zemax BSDF file has {name} {words[name]}; only {read} is read.")
    rotation, *angles = (_numbers_after(name, lines[:begin]) for name in _ZEMAX_LISTS)
    if rotation.size != 1:
        raise MeasurementFormatError("The Zemax BSDF file has several sample rotations; a material here is isotropic.")
    a, turn, away = (axis.ravel() for axis in np.meshgrid(*map(np.radians, angles), indexing="ij"))
    check_size(a.size, len(VECTORS) + 1)
    cells = [*chain.from_iterable(line for line in lines[begin + 1 :] if line[0] not in ("TIS", "DataEnd"))]
    if len(cells) != a.size:
        raise MeasurementFormatError(f"The Zemax BSDF file has {len(cells)} values, and its angles need {a.size}.")
    values = np.array(cells, dtype=np.float64)
    zero = np.zeros_like(a)
    mirror, to_normal = np.stack([np.sin(a), zero, np.cos(a)]), np.stack([-np.cos(a), zero, np.sin(a)])
    aside = np.stack([zero, zero + 1.0, zero])
    omega_out = np.cos(away) * mirror + np.sin(away) * (np.cos(turn) * to_normal + np.sin(turn) * aside)
    return TextTable.of_numbers((*VECTORS, "value"), [-np.sin(a), zero, np.cos(a), *omega_out, values])


def _lighttools_table(text: str) -> TextTable:
    """Return the samples of front reflection in a LightTools file, whose light comes from an azimuth of 90 degrees."""
    head, _, body = text.partition("DataBegin")
    lines = _words(head)
    phi, theta = _numbers_after("ScatterAzimuth", lines)[:, np.newaxis], _numbers_after("ScatterRadial", lines)
    blocks, state = list[Array](), {"ScatterType": "BRDF", "Side": "Front", "AOI": "0", "Wavelength": "0"}
    for words, numbers in _LIGHTTOOLS_BLOCK.findall(body):
        state |= dict(line.split()[:2] for line in words.splitlines())
        if "TristimulusValue" in state:
            raise MeasurementFormatError("The file of LightTools has tristimulus values; only Monochrome is read.")
        values = np.array(numbers.split(), dtype=np.float64)
        if values.size == 0 or (state["ScatterType"], state["Side"]) != ("BRDF", "Front"):
            continue
        values = values.reshape(phi.size, theta.size)
        blocks.append(_block(theta, phi, values, float(state["AOI"]), 90.0, float(state["Wavelength"])))
    if not blocks:
        raise MeasurementFormatError("The file of LightTools has no BRDF of the front side.")
    return _table_of_blocks(blocks)


def fred_table(data: bytes) -> TextTable | None:
    """Return the samples of a FRED file, in which light and viewer have equal azimuths in the mirror direction."""
    if not _FRED.match(data):
        return None
    lines = rows_of(decoded(data).splitlines())
    words = dict(re.findall(r"(\w+)=(\S+)", " ".join(line for _, line in lines[:20] if "=" in line)))
    if words.get("bsdf", "value") != "value":
        raise MeasurementFormatError(f"The file of FRED has bsdf={words['bsdf']}; only bsdf=value is read.")
    table = unnamed_table([(number, line) for number, line in lines if "=" not in line and "bsdf_data" not in line])
    unit, half_turn = ("rad", np.pi) if words.get("angles", "deg").startswith("rad") else ("deg", 180.0)
    # The numbers before each block became the last columns; a file of a single plane of incidence has no azimuths.
    names = {3: ("theta_out", "value", "theta_in"), 5: _NAMES[:5]}.get(len(table.names))
    if names is None:
        raise MeasurementFormatError(
            f"The file of FRED has lines of {table.n_cells} numbers and blocks of {len(table.names) - table.n_cells}; "
            "it needs theta, phi and BSDF after lines of theta and phi of the light."
        )
    columns = {name: table.numbers(at) for at, name in enumerate(names)}
    columns["value"] = columns["value"] * float(words.get("scale", 1.0))
    if "phi_in" in columns:
        columns["phi_in"] = columns["phi_in"] + half_turn
    return TextTable.of_numbers([name if name == "value" else f"{name} [{unit}]" for name in columns], columns.values())


def speos_table(data: bytes) -> TextTable | None:
    """Return the samples of a Speos file, in which light and viewer have equal azimuths in the mirror direction."""
    if not data.startswith(_SPEOS):
        return None
    lines = data.decode("latin-1").splitlines()
    if lines[1].strip() != "0":
        raise MeasurementFormatError("The file of Speos is binary; export it as text.")
    rest = "\n".join(lines[4:])[int(lines[3]) :].split()
    if rest[2] != "1":
        raise MeasurementFormatError("The file of Speos has intensities; values proportional to the BSDF are read.")
    (n_in, n_bands), numbers = map(int, rest[3:5]), np.array(rest[5:], dtype=np.float64)
    theta_in, wavelengths, numbers = np.split(numbers, [n_in, n_in + n_bands])
    blocks = list[Array]()
    for incidence, wavelength in np.stack(np.meshgrid(theta_in, wavelengths, indexing="ij"), -1).reshape(-1, 2):
        n_theta, n_phi = int(numbers[1]), int(numbers[2])
        phi, rows, numbers = np.split(numbers[3:], [n_phi, n_phi + n_theta * (n_phi + 1)])
        rows = rows.reshape(n_theta, n_phi + 1)
        blocks.append(_block(rows[:, :1], phi, rows[:, 1:], incidence, 180.0, wavelength))
    return _table_of_blocks(blocks)


def _block(*columns: ArrayLike) -> Array:
    """Return a block of samples on a grid of directions, shape (6, n): rows are the columns that `_NAMES` lists."""
    return np.stack([column.ravel() for column in np.broadcast_arrays(*columns)])


def _table_of_blocks(blocks: Sequence[Array]) -> TextTable:
    """Join blocks of samples into a table, without a column for the wavelength if all blocks have one wavelength."""
    columns = np.concatenate(blocks, axis=1)
    is_spectral = len(np.unique(columns[5])) > 1
    return TextTable.of_numbers(_NAMES[: 5 + is_spectral], columns[: 5 + is_spectral])


def _words(text: str) -> list[list[str]]:
    return [words for line in text.splitlines() if (words := line.split()) and words[0][0] != "#"]


def _numbers_after(name: str, head: Sequence[list[str]]) -> Array:
    """Return a list of numbers from the head of a file, where a line with its name and its length precedes the list."""
    count = 0
    try:
        at = next(at for at, line in enumerate(head) if line[0] == name)
        count, cells = int(head[at][1]), [*head[at][2:], *chain.from_iterable(head[at + 1 :])]
        numbers = np.array(cells[:count], dtype=np.float64)
    except (StopIteration, IndexError, ValueError):
        numbers = np.zeros(0)
    if numbers.size == 0 or numbers.size != count or not np.isfinite(numbers).all():
        raise MeasurementFormatError(f"The BSDF file has no line {name} with a count, and the angles below it.")
    return numbers
