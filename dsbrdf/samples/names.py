"""Names of columns of tables of samples, as people and instruments write them."""

import re
import unicodedata
from collections.abc import Iterator

from dsbrdf.data.grid import CHANNELS

# side of the normal -> what stands before or behind an angle's name; abbreviations stand behind it only
_SIDES = {
    "in": ("in", "incident", "incidence", "incoming", "illumination", "light", "source", "solar", "sun"),
    "out": (
        *("out", "reflected", "reflection", "outgoing", "exitant", "scattered", "scatter", "scattering", "receiver"),
        *("view", "viewing", "viewer", "observer", "observation"),
    ),
}
_SHORT = {"in": ("i", "incident"), "out": ("o", "r", "s")}
_ANGLES = {
    "theta": ("theta", "zenith", "polar", "zenith_angle", "polar_angle"),
    "phi": ("phi", "azimuth", "azimuth_angle", "azimuthal_angle"),
    "elevation": ("elevation", "altitude", "elevation_angle"),
}
_OTHERS = {
    "theta_in": ("aoi", "angle_of_incidence", "sza", "incidence", "einfallswinkel"),
    "theta_out": (
        *("aor", "aos", "angle_of_reflection", "angle_of_scatter", "vza", "theta", "zenith", "zenith_angle"),
        *("ausfallswinkel", "beobachtungswinkel"),
    ),
    "phi_in": ("saa",),
    "phi_out": ("vaa", "phi", "azimuth", "azimuth_angle", "relative_azimuth", "raa"),
    "elevation_out": ("elevation", "elevation_angle"),
    "value": ("value", "brdf", "bsdf", "luminance", "f_r", "fr"),
    "weight": ("weight",),
    "wavelength": ("wavelength", "lambda", "wl", "wavelength_nm"),
}
VECTORS = tuple(f"omega_{side}_{axis}" for side in _SIDES for axis in "xyz")
HALF_DIFFERENCE = ("theta_half", "theta_diff", "phi_diff")
DEGREES, RADIANS = ("deg", "degree", "degrees", "°"), ("rad", "radian", "radians")
_LONGEST_NAME = 200  # characters of a cell with a name and its unit
_BAND = re.compile(r"(?:(?:value|brdf|bsdf|f_?r?|r|l|w|wl|lambda)_?)?([0-9]{3,4}(?:_[0-9]+)?)_?(?:nm)?")
_FIRST_BAND, _LAST_BAND = 200.0, 3000.0  # [nm]


def _spellings() -> Iterator[tuple[str, str]]:
    for meaning, names in _OTHERS.items():
        yield from ((name, meaning) for name in names)
    for side, words in _SIDES.items():
        yield from ((f"{word}_angle", f"theta_{side}") for word in words)
        for angle, names in _ANGLES.items():
            for name in names:
                yield from ((f"{word}_{name}", f"{angle}_{side}") for word in words)
                for word in (*words, *_SHORT[side]):
                    yield from ((f"{name}{mark}{word}", f"{angle}_{side}") for mark in ("_", ""))
        for axis in "xyz":
            yield from ((f"{name}_{axis}", f"omega_{side}_{axis}") for name in (f"omega_{side}", f"omega_{side[0]}"))
            yield f"w{side[0]}_{axis}", f"omega_{side}_{axis}"
    for name in HALF_DIFFERENCE:
        angle, _, of = name.partition("_")
        yield from ((spelling, name) for spelling in (name, f"{angle}{of}", f"{angle}_{of[0]}"))
    for channel in CHANNELS:
        yield from ((spelling, channel) for spelling in (channel, channel[0], f"brdf_{channel}", f"brdf_{channel[0]}"))


MEANINGS = dict(_spellings())
"""What each spelling means."""


def is_known(cell: str) -> bool:
    """Whether a cell is one of the spellings of a column's name."""
    return name_and_unit(cell)[0] in MEANINGS


def wavelength_of(cell: str) -> float | None:
    """Return the wavelength [nm] that a column with this name is for, as in "450 nm", "450" or "brdf_450nm"."""
    found = _BAND.fullmatch(name_and_unit(cell)[0])
    number = 0.0 if found is None else float(found[1].replace("_", "."))
    return number if _FIRST_BAND <= number <= _LAST_BAND else None


def name_and_unit(cell: str) -> tuple[str, str]:
    """Return the name in a cell in lower case, Greek letters as words, and the unit after it, if any."""
    if len(cell) > _LONGEST_NAME:
        return cell, ""
    text, unit = unicodedata.normalize("NFKC", cell).strip().strip("'\"").strip().lower(), ""
    for letter, word in (("θ", "theta"), ("φ", "phi"), ("λ", "lambda"), ("ω", "omega")):
        text = text.replace(letter, word)
    bracket = min((place for mark in "[(" if (place := text.find(mark)) >= 0), default=-1)
    if bracket >= 0 and text.endswith(("]", ")")):
        text, unit = text[:bracket].rstrip(), text[bracket + 1 : -1].strip()
    name = re.sub(r"[\s.-]+", "_", text)
    base, _, last = name.rpartition("_")
    return (base, last) if last in (*DEGREES, *RADIANS) else (name, unit.replace("\N{MINUS SIGN}", "-"))
