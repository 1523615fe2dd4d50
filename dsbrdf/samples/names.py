"""Recognise the names of columns in tables of samples, as people and instruments write them."""

import re
import unicodedata
from collections.abc import Collection, Iterator, Sequence
from math import pi

from dsbrdf.data.grid import CHANNELS

# These words name omega_in or omega_out, before or after the name of an angle; the abbreviations occur only after it.
_SIDES = {
    "in": ("in", "incident", "incidence", "incoming", "illumination", "light", "source", "src", "solar", "sun"),
    "out": (
        *("out", "reflected", "reflection", "outgoing", "exitant", "exit", "scattered", "scatter", "scattering"),
        *("receiver", "detector", "view", "viewing", "viewer", "observer", "observation"),
    ),
}
_SIDE_ABBREVIATIONS = {"in": ("i", "incident"), "out": ("o", "r", "s")}
_ANGLES = {
    "theta": ("theta", "zenith", "polar", "zenith_angle", "polar_angle"),
    "phi": ("phi", "azimuth", "azimuth_angle", "azimuthal_angle"),
    "elevation": ("elevation", "altitude", "elevation_angle"),
}
# Abbreviations that follow only a full word, because "in_z" would be a component of a vector.
_BEHIND_WORDS = {"theta": ("z", "za", "zen"), "phi": ("a", "aa", "az", "azi")}
_VALUES = (
    "value",
    "brdf",
    "bsdf",
    "frdb",
    "luminance",
    "f_r",
    "fr",
    "brdf_mean",
    "bsdf_mean",
    "mean_brdf",
    "mean_bsdf",
)
_MUELLER = tuple(f"{name}{mark}11" for name in ("f_r", "fr", "f", "m", "s", "mueller", "brdf") for mark in ("", "_"))
_FACTORS = ("brf", "reflectance", "reflectance_factor", "bidirectional_reflectance_factor", "radiance_factor")
_OTHERS = {
    "theta_in": ("aoi", "angle_of_incidence", "sza", "incidence", "einfallswinkel", "angle_d'incidence", "intheta"),
    "theta_out": (
        *("aor", "aos", "aov", "angle_of_reflection", "angle_of_scatter", "angle_of_view", "vza", "theta", "zenith"),
        *(
            "zenith_angle",
            "scatter",
            "scatterbeta",
            "ausfallswinkel",
            "beobachtungswinkel",
            "angle_de_réflexion",
            "outtheta",
        ),
    ),
    "phi_in": ("saa", "inphi"),
    "phi_out": ("vaa", "phi", "azimuth", "azimuth_angle", "azimut", "relative_azimuth", "raa", "outphi"),
    "elevation_out": ("elevation", "elevation_angle"),
    "value": (*_VALUES, *_MUELLER, *_FACTORS),
    "weight": ("weight",),
    "wavelength": ("wavelength", "lambda", "wl"),
}
VECTORS = tuple(f"omega_{side}_{axis}" for side in _SIDES for axis in "xyz")
HALF_DIFFERENCE = ("theta_half", "theta_diff", "phi_diff")
ANGLE_UNITS = {"deg": pi / 180.0, "degree": pi / 180.0, "degrees": pi / 180.0, "°": pi / 180.0}
ANGLE_UNITS |= {"rad": 1.0, "radian": 1.0, "radians": 1.0}
"""Factors that convert units of angles to radians."""
WAVELENGTH_UNITS = {"nm": 1.0, "um": 1e3, "μm": 1e3, "micron": 1e3, "microns": 1e3, "m": 1e9}
"""Factors that convert units of wavelengths to nanometres."""
_MATRICES = ({"theta_in", "theta_out"}, {"theta_out", "phi_out"})
_N_MATRIX_NAMES = 3  # The first cell of a matrix counts as three names: rows, columns, values.
_MAX_NAME_LENGTH = 200  # [characters] with the unit.
_BAND = re.compile(r"(?:(?:value|brdf|bsdf|f_?r?|r|l|w|wl|lambda)_?)?([0-9]+(?:_[0-9]+)?)_?(nm|um|μm)?")
_MIN_BAND_NM = 200.0
_MAX_BAND_NM = 3000.0
_NUMBER = r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?"
_CONSTANT = re.compile(rf"(.*?[^\s:=,;])[\s:=,;]+({_NUMBER}(?:[\s,;]+{_NUMBER})?)[\s,;]*([A-Za-zμ°]*)")
# A line can give these quantities to all rows below it.
_HELD = ("theta_in", "phi_in", "elevation_in", "wavelength")


def _spellings() -> Iterator[tuple[str, str]]:
    for meaning, names in _OTHERS.items():
        yield from ((name, meaning) for name in names)
    for side, words in _SIDES.items():
        yield from ((f"{word}_angle", f"theta_{side}") for word in words)
        for angle, names in _ANGLES.items():
            for name in names:
                yield from ((f"{word}_{name}", f"{angle}_{side}") for word in words)
                for word in (*words, *_SIDE_ABBREVIATIONS[side]):
                    yield from ((f"{name}{mark}{word}", f"{angle}_{side}") for mark in ("_", ""))
        for angle, names in _BEHIND_WORDS.items():
            yield from ((f"{word}_{name}", f"{angle}_{side}") for word in words[1:] for name in names)
        for axis in "xyz":
            yield from ((f"{name}_{axis}", f"omega_{side}_{axis}") for name in (f"omega_{side}", f"omega_{side[0]}"))
            yield f"w{side[0]}_{axis}", f"omega_{side}_{axis}"
    for name in HALF_DIFFERENCE:
        angle, _, of = name.partition("_")
        yield from ((spelling, name) for spelling in (name, f"{angle}{of}", f"{angle}_{of[0]}"))
    for channel in CHANNELS:
        yield from ((spelling, channel) for spelling in (channel, channel[0], f"brdf_{channel}", f"brdf_{channel[0]}"))


MEANINGS = dict(_spellings())
"""Meaning of a column by the spelling of its name."""


def meaning_of(cell: str) -> str | None:
    """Return the meaning of a column with this name, or None if the name is unknown."""
    return MEANINGS.get(name_and_unit(cell)[0])


def is_factor(cell: str) -> bool:
    """Return whether a cell names reflectance factors, which are pi times the BRDF."""
    return name_and_unit(cell)[0] in _FACTORS


def matrix_names(cell: str) -> tuple[str, ...]:
    r"""Return the names in a cell such as "theta_out / theta_in" or "AOR \ AOI [deg]", the name of the rows first."""
    name, unit = name_and_unit(cell)
    parts = [part.strip("_ ") for part in re.split(r"[/\\|]", name)]
    if {MEANINGS.get(part) for part in parts} not in _MATRICES or len(parts) != len(_MATRICES[0]):
        return ()
    return tuple(f"{part} [{unit}]" if unit else part for part in parts)


def count_names(cells: Sequence[str], named: Collection[str] = ()) -> int:
    """Count the cells that name a column; `named` has further names in lower case.

    Wavelengths count if there are several, and if a cell is more than a number.
    """
    known = sum(bool(meaning_of(cell)) or cell.strip("'\" ").lower() in named for cell in cells)
    matrices = _N_MATRIX_NAMES * sum(bool(matrix_names(cell)) for cell in cells)
    bands = sum(bool(wavelength_of(cell)) for cell in cells)
    has_words = any(not cell.replace(".", "").isdigit() for cell in cells)
    return known + matrices + (bands if bands > 1 and has_words else 0)


def wavelength_of(cell: str) -> float | None:
    """Return the wavelength [nm] in the name of a column, such as "450 nm", "0.45um" or "brdf_450nm", or None."""
    found = _BAND.fullmatch(name_and_unit(cell)[0])
    number = 0.0 if found is None else float(found[1].replace("_", ".")) * WAVELENGTH_UNITS[found[2] or "nm"]
    return number if _MIN_BAND_NM <= number <= _MAX_BAND_NM else None


def constants_in(line: str) -> dict[str, float]:
    """Return the numbers that a line such as "#intheta 30" or "AOI [deg]: 30" gives to all rows below it."""
    found = _CONSTANT.fullmatch(line) if len(line) <= _MAX_NAME_LENGTH else None
    if found is None:
        return {}
    name, unit = name_and_unit(found[1])
    meaning = "theta_in" if name == "incident_angle" else MEANINGS.get(name)
    try:
        numbers = [float(number) for number in re.split(r"[\s,;]+", found[2].strip(" \t,;"))]
    except ValueError:
        return {}
    if meaning not in _HELD or len(numbers) > (2 if name == "incident_angle" else 1):
        return {}
    unit = unit or found[3].lower()
    held = {f"{meaning} [{unit}]" if unit else meaning: numbers[0]}
    return held | dict(zip(("phi_in",), numbers[1:], strict=False))


def name_and_unit(cell: str) -> tuple[str, str]:
    """Return the name in a cell in lower case, Greek letters as words, and the unit after it, if any."""
    if len(cell) > _MAX_NAME_LENGTH:
        return cell, ""
    text, unit = unicodedata.normalize("NFKC", cell).strip().strip("'\"").strip().lower(), ""
    for letter, word in (("θ", "theta"), ("φ", "phi"), ("λ", "lambda"), ("ω", "omega")):
        text = text.replace(letter, word)
    bracket = min((place for mark in "[(" if (place := text.find(mark)) >= 0), default=-1)
    if bracket >= 0 and text.endswith(("]", ")")):
        text, unit = text[:bracket].rstrip(), text[bracket + 1 : -1].strip()
    name = re.sub(r"[\s.-]+", "_", text)
    base, _, last = name.rpartition("_")
    is_unit = last in ANGLE_UNITS or (last in WAVELENGTH_UNITS and base in _OTHERS["wavelength"])
    return (base, last) if is_unit else (name, unit.replace("\N{MINUS SIGN}", "-"))
