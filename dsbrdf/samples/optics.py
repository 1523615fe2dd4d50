"""Files of samples for programs of optical design: FRED, LightTools and Speos.

Sources: FRED's tabulated BSDF (Photon Engineering, FRED help, "Tabulated BSDF"; written by ua-loft/bsdf-tools),
LightTools' BSDF text (read by libbsdf, LightToolsBsdfReader), and Speos' BRDF file (Ansys help, "Structure of BRDF
files"; written by Ansys' BSDF converter).
"""

import re

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import TextTable
from dsbrdf.samples.text_table import decoded_lines
from dsbrdf.samples.unnamed import unnamed_table
from dsbrdf.samples.zemax import MAX_HEAD_BYTES, numbers_after

_FRED = re.compile(rb"(?m)\A(?:\s*[#!].*\n|\s*\n)*\s*(?:type\s+)?bsdf_data\b")
_LIGHTTOOLS_BLOCK = re.compile(r"((?:^[ \t]*[A-Za-z]\w*[ \t]+\S+[ \t\r]*\n)+)([-+0-9.eE\s]*)", re.MULTILINE)
_SPEOS = b"OPTIS - brdf surface file"
_PER_DIRECTION = ("theta_out", "phi_out", "value")


def is_fred(data: bytes) -> bool:
    """Whether a text is a tabulated BSDF of FRED."""
    return _FRED.match(data) is not None


def fred_table(data: bytes) -> TextTable:
    """Return the samples of a file of FRED; light and viewer have one azimuth in its mirror direction."""
    lines = decoded_lines(data)
    words = dict(re.findall(r"(\w+)=(\S+)", " ".join(line for _, line in lines[:20] if "=" in line)))
    if words.get("bsdf", "value") != "value":
        raise MeasurementFormatError(f"The file of FRED has bsdf={words['bsdf']}; bsdf=value alone is read.")
    try:
        scale = float(words.get("scale", 1.0))
    except ValueError:
        raise MeasurementFormatError(f"The file of FRED has scale={words['scale']}, which is no number.") from None
    table = unnamed_table([(number, line) for number, line in lines if "=" not in line and "bsdf_data" not in line])
    column = [table.numbers(at) for at in range(len(table.names))]
    unit = "rad" if words.get("angles", "deg").startswith("rad") else "deg"
    # Blocks in one plane have theta_out and a value; the theta_in that leads each block becomes the last column.
    if len(column) == 3:
        return TextTable.of_numbers((f"theta_out [{unit}]", "value", f"theta_in [{unit}]"), _scaled(column, 1, scale))
    if len(column) != 5:
        raise MeasurementFormatError(
            f"The file of FRED has lines of {table.n_cells} numbers and blocks of {len(column) - table.n_cells}; it "
            "needs theta, phi and BSDF after lines of theta and phi of the light."
        )
    column[4] = column[4] + (np.pi if unit == "rad" else 180.0)
    names = (f"theta_out [{unit}]", f"phi_out [{unit}]", "value", f"theta_in [{unit}]", f"phi_in [{unit}]")
    return TextTable.of_numbers(names, _scaled(column, 2, scale))


def _scaled(column: list[Array], at: int, scale: float) -> list[Array]:
    return [*column[:at], column[at] * scale, *column[at + 1 :]]


def is_lighttools(data: bytes) -> bool:
    """Whether a text is a BSDF file of LightTools."""
    head = data[:MAX_HEAD_BYTES]
    return b"ScatterRadial" in head and re.search(rb"(?m)^[ \t]*AOI[ \t]+[-+0-9.]", head) is not None


def lighttools_table(data: bytes) -> TextTable:
    """Return what the front reflects of a file of LightTools, whose light comes from an azimuth of 90 degrees."""
    head, _, body = data.decode("latin-1").partition("DataBegin")
    lines = [line.split() for line in head.splitlines() if line.strip() and line.strip()[0] != "#"]
    phi, theta = numbers_after("ScatterAzimuth", lines), numbers_after("ScatterRadial", lines)
    grid = np.meshgrid(theta, phi)
    columns, state = list[Array](), {"ScatterType": "BRDF", "Side": "Front"}
    for words, numbers in re.findall(
        r"((?:^[ \t]*[A-Za-z]\w*[ \t]+\S+[ \t\r]*\n)+)([-+0-9.eE\s]*)", body, re.MULTILINE
    ):
        state |= dict(line.split()[:2] for line in words.splitlines())
        if "TristimulusValue" in state:
            raise MeasurementFormatError("The file of LightTools has tristimulus values; Monochrome alone is read.")
        values = np.array(numbers.split(), dtype=np.float64)
        if values.size == 0 or state["ScatterType"] != "BRDF" or state["Side"] != "Front":
            continue
        if values.size != grid[0].size:
            raise MeasurementFormatError(
                f"The file of LightTools has {values.size} values at AOI {state.get('AOI')}; its angles need "
                f"{grid[0].size}."
            )
        at = [
            np.full(values.size, float(state.get(name, nothing))) for name, nothing in (("AOI", 0), ("Wavelength", 0))
        ]
        columns.append(np.stack([grid[0].ravel(), grid[1].ravel(), values, at[0], np.full(values.size, 90.0), at[1]]))
    if not columns:
        raise MeasurementFormatError("The file of LightTools has no BRDF of the front side.")
    table = np.concatenate(columns, axis=1)
    several = np.unique(table[5]).size > 1
    names = (*_PER_DIRECTION, "theta_in", "phi_in", *(("wavelength",) if several else ()))
    return TextTable.of_numbers(names, list(table[: len(names)]))


def is_speos(data: bytes) -> bool:
    """Whether a text is a BRDF file of Speos."""
    return data.startswith(_SPEOS)


def speos_table(data: bytes) -> TextTable:
    """Return the samples of a text of Speos; light and viewer have one azimuth in its mirror direction."""
    text = data.decode("latin-1")
    lines = text.splitlines()
    try:
        if lines[1].strip() != "0":
            raise MeasurementFormatError("The file of Speos is binary; export it as text.")
        rest = "\n".join(lines[4:])[int(lines[3]) :].split()
        if rest[2] != "1":
            raise MeasurementFormatError("The file of Speos has intensities; values proportional to the BSDF are read.")
        counts, numbers = (int(rest[3]), int(rest[4])), np.array(rest[5:], dtype=np.float64)
        theta_in, wavelengths = numbers[: counts[0]], numbers[counts[0] : sum(counts)]
        at, columns = sum(counts), list[Array]()
        for incidence in theta_in:
            for wavelength in wavelengths:
                n_theta, n_phi = int(numbers[at + 1]), int(numbers[at + 2])
                at += 3
                phi, rows = numbers[at : at + n_phi], numbers[at + n_phi : at + n_phi + n_theta * (n_phi + 1)]
                rows = rows.reshape(n_theta, n_phi + 1)
                at += n_phi + n_theta * (n_phi + 1)
                grid = np.broadcast_arrays(rows[:, :1], phi, rows[:, 1:], incidence, 180.0, wavelength)
                columns.append(np.stack([axis.ravel() for axis in grid]))
    except (IndexError, ValueError):
        raise MeasurementFormatError("The file of Speos is cut off or damaged.") from None
    names = (*_PER_DIRECTION, "theta_in", "phi_in", *(("wavelength",) if wavelengths.size > 1 else ()))
    return TextTable.of_numbers(names, list(np.concatenate(columns, axis=1)[: len(names)]))
