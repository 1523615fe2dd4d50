"""Recognise the names of columns in tables of samples, as people and instruments write them."""

import re
import unicodedata
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from math import pi

from dsbrdf.data.geometry import CHANNELS

_SIDE_WORDS = {
    "in": "in i inc incident incidence incoming input ill illum illumination light source src solar sol sun quelle",
    "out": (
        "out o r s v e output ref refl reflected reflection outgoing exitant exit emergent emergence emission scat "
        "scattered scatter scattering receiver detector detection det view viewing viewer observer observation obs "
        "sensor sen detektor réfléchi"
    ),
}
_ANGLE_WORDS = {
    "theta": "theta zenith polar zen za z",
    "phi": "phi azimuth azimuthal azimut azim azm azi az aa a",
    "elevation": "elevation elev el altitude grazing glancing",
}
_SIDES = {word: side for side, words in _SIDE_WORDS.items() for word in words.split()}
_ANGLES = {word: angle for angle, words in _ANGLE_WORDS.items() for word in words.split()}
# These short names are angles only after a long word, as in "sun_z"; after a short one, "in_z", they belong to vectors.
_SHORT_ANGLES = {"za", "z", "aa", "a"}
_SHORT_SIDES = {"in", "out", "i", "o", "r", "s", "v", "e"}
_RELATIVE = {"relative", "rel", "delta", "difference", "d"}
_FILLERS = {"angle", "angles", "of", "the"}
_GLUED = re.compile(
    "(theta|phi|zenith|azimuth|in|out|sol|sen|rel|delta|d)(theta|phi|zenith|azimuth|az|inc|ref|in|out|[iorsvza])"
)
_FACTORS = (
    *("brf", "hdrf", "hcrf", "rho", "refl", "reff", "reflectance", "reflectivity", "reflectance_factor"),
    *("bidirectional_reflectance_factor", "radiance_factor"),
)
_RADIANCE_FACTORS = ("i/f", "i_over_f", "iof", "radf")
_DENSITIES = ("value", "brdf", "bsdf", "frdb", "f_r", "fr")
_TIMES_COSINE = ("dsf", "ccbsdf", "ccbrdf")
_VALUES = (
    *(*_DENSITIES, *_TIMES_COSINE, "luminance", "luminance_coefficient", "leuchtdichtekoeffizient"),
    *(f"{name}{mark}11" for name in ("f_r", "fr", "f", "m", "s", "mueller", "brdf") for mark in ("", "_")),
)
# A name of values may have one of these words more, as in "Panel BRF".
_QUALIFIERS = {"panel", "sample", "target", "measured", "mean", "average", "calibrated", "corrected", "absolute"}
_OTHERS = {
    "theta_in": (
        *("aoi", "sza", "incidence", "incident", "einfallswinkel", "beleuchtungswinkel", "angle_dincidence"),
        *("入射角", "入射天顶角"),
    ),
    "theta_out": (
        *("aor", "aos", "aov", "vza", "scatter", "scatterbeta", "emission", "emergence", "viewing"),
        *("ausfallswinkel", "beobachtungswinkel", "betrachtungswinkel", "angle_de_réflexion"),
        *("反射角", "出射角", "出射天顶角", "受光角", "观测角", "観測角"),
    ),
    "phi_in": ("saa", "入射方位角"),
    "phi_out": ("vaa", "raa", "azimutdifferenz", "方位角", "出射方位角", "反射方位角", "相对方位角", "相対方位角"),
    "phase": ("phase", "phase_angle"),
    "theta_from_mirror": ("angle_from_specular", "degrees_from_specular"),
    "value": (*_VALUES, *_FACTORS, *_RADIANCE_FACTORS),
    "weight": ("weight",),
    "wavelength": (
        "wavelength",
        "wellenlänge",
        "波长",
        "波長",
        "wavelength_i",
        "lambda",
        "wl",
        "wavenumber",
        "wave_number",
    ),
}
TRISTIMULUS = ("cie_x", "cie_y", "cie_z")
VECTORS = tuple(f"omega_{side}_{axis}" for side in _SIDE_WORDS for axis in "xyz")
HALF_DIFFERENCE = ("theta_half", "theta_diff", "phi_diff")
COSINE = "cosine"
"""The unit of a column that has the cosines of angles instead of the angles."""
ANGLE_UNITS = {"deg": pi / 180.0, "degree": pi / 180.0, "degrees": pi / 180.0, "°": pi / 180.0}
ANGLE_UNITS |= {"rad": 1.0, "radian": 1.0, "radians": 1.0, "gon": pi / 200.0}
"""Factors that convert units of angles to radians."""
WAVELENGTH_UNITS = {"nm": 1.0, "um": 1e3, "μm": 1e3, "micron": 1e3, "microns": 1e3, "m": 1e9, "å": 0.1}
"""Factors that convert units of wavelengths to nanometres."""
RECIPROCAL_UNITS = dict.fromkeys(("1/cm", "cm-1", "cm^-1", "cm**-1"), 1e7) | {"thz": 299792.458, "ev": 1239.84198}
"""Numerators [nm] that units of wavenumbers, frequencies and photon energies divide to give wavelengths."""
VALUE_UNITS = ("1/sr", "sr^-1", "sr-1", "sr**-1", "per sr", "1 / sr")
"""Units of a BRDF."""
# The first element of a Mueller matrix, if its elements are counted from 0, is the BRDF for unpolarised light.
_FIRST_OF_MATRIX = re.compile(r"(?:f_?r?|m|s|mueller|brdf)_?00")
# Tables of planetary science have these letters as names of the angles of incidence, emission and phase.
_PLANETARY = {"i": "theta_in", "e": "theta_out", "g": "phase", "alpha": "phase"}
_SOLAR = {"theta_s": "theta_in", "phi_s": "phi_in"}  # In a table that has "v" for the viewer, "s" means the sun.
_GREEK = {"θ": "theta", "φ": "phi", "λ": "lambda", "ω": "omega", "δ": "delta", "ρ": "rho", "β": "beta"}
_COSINE = re.compile(r"cos(?:ine)?(?:[_ ]?\((.+)\)|[_ ](.+))")
# This means the cosine of theta_out, as in "ccbrdf", unless another angle is named.
_PRODUCT = re.compile(r"(?:brdf|bsdf|f_?r) ?[*×·x] ?cos(?:ine)?(?:[_ ]?\(?theta_?(?:out|[orsv])\)?)?")
# A unit may follow a name without brackets, as in "theta / deg", "BRDF, 1/sr" or "brdf_sr-1".
_UNIT_BEHIND = re.compile(
    rf"(.+?)(?:(?: ?/ ?|, ?| in )({'|'.join(map(re.escape, (*ANGLE_UNITS, *WAVELENGTH_UNITS, *VALUE_UNITS, '%')))})|"
    rf"_({'|'.join(map(re.escape, VALUE_UNITS))}))"
)
# A column is in decibels or another logarithm if its unit, or the first or the last word of its name, is one of these.
_LOGARITHM = re.compile(r"(?:10_?\*_?)?(?:d_?b|dex|ln|lg|log(?:_?10)?|decibels?|od|density)")
# LaTeX, quotation marks and arguments, as in f_r(theta_i, theta_r), are removed from a name.
_MARKUP = re.compile(r"[$\\{}'’\"#]|\([^()=]*theta[^()=]*,[^()=]*\)")
_BAND_IN_BRACKETS = re.compile(r"(?:lambda ?= ?)?([0-9.]+ ?(?:nm|um|μm)?)")
_MATRICES = ({"theta_in", "theta_out"}, {"theta_out", "phi_out"}, {"theta_out", "wavelength"})
_N_MATRIX_NAMES = 3  # The first cell of a matrix counts as three column names: two angles and the values.
_MAX_NAME_LENGTH = 200  # A longer cell is not searched for a column name and its unit [characters].
_BAND = re.compile(
    rf"(?:(?:{'|'.join((*_FACTORS, *_DENSITIES))}|beta|rrs|band|b|f|r|l|w|wl|lambda)_?)?"
    "([0-9]+(?:_[0-9]+)?)_?(nm|um|μm)?"
)
_FACTOR = re.compile(rf"(?:{'|'.join(_FACTORS)})(?:_?[0-9].*|_[a-z]+)?|beta_?[0-9].*")
MIN_BAND_NM = 200.0
MAX_BAND_NM = 3000.0
_NUMBER = r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?"
_CONSTANT = re.compile(rf"(.*?[^\s:=,;])[\s:=,;]+({_NUMBER}(?:[\s,;]+{_NUMBER})?)[\s,;]*([A-Za-zμ°]*)")
_DECIMAL_COMMA = re.compile(r"(?<![,.\d])(\d+),(\d\d?)(?![,\d])")  # Behind a comma, numbers are separated by commas.
# A line of a file can state one of these quantities for all rows below the line.
_HELD = ("theta_in", "phi_in", "elevation_in", "theta_out", "phi_out", "wavelength")


def _spellings() -> Iterator[tuple[str, str]]:
    for meaning, names in _OTHERS.items():
        yield from ((name, meaning) for name in names)
    for side in _SIDE_WORDS:
        for axis in "xyz":
            for name in (f"omega_{side}", f"omega_{side[0]}", f"w{side[0]}", "l" if side == "in" else "v"):
                yield from ((f"{name}_{axis}", f"omega_{side}_{axis}"), (f"{name}{axis}", f"omega_{side}_{axis}"))
    for name in HALF_DIFFERENCE:
        angle, _, of = name.partition("_")
        yield from ((spelling, name) for spelling in (name, f"{angle}{of}", f"{angle}_{of[0]}"))
    for name in TRISTIMULUS:
        yield from ((spelling, name) for spelling in (name, name.replace("_", ""), f"tristimulus_{name[-1]}"))
    for channel in CHANNELS:
        for spelling in (channel, channel[0]):
            yield spelling, channel
            yield from ((f"{name}_{spelling}", channel) for name in (*_DENSITIES, *_FACTORS))


_EXACT = dict(_spellings())


def meanings_of(cells: Sequence[str]) -> list[str | None]:
    """Return the meaning, such as theta_in, of each column name in a table, or None; some depend on other names."""
    names, units = zip(*map(name_and_unit, cells), strict=True) if cells else ((), ())
    special = _PLANETARY if {"i", "e"} <= {*names} else _SOLAR if {"theta_v", "phi_v"} & {*names} else {}
    vectors = {
        f"{word}_{axis}": f"omega_{side}_{axis}"
        for word, side in _SIDES.items()
        if f"{word}_x" in names
        for axis in "xyz"
    }
    known = {
        name: special.get(name) or vectors.get(name) or _meaning(name) or _meaning_by_unit(name, unit)
        for name, unit in zip(names, units, strict=True)
    }

    def having(meaning: str) -> list[str]:
        return [name for name in names if known[name] == meaning]

    # A scattering angle beside another theta_out is the angle between light and viewer, and is ignored.
    ignored = {"scattering_angle"} if len(having("theta_out")) > 1 else set()
    relative, viewers = {name for name in names if name == "raa" or _RELATIVE & {*name.split("_")}}, having("phi_out")
    if len(viewers) > 1 and relative:
        # If there is no azimuth of the light, a relative azimuth is used instead of the azimuth of the viewer.
        ignored |= relative if having("phi_in") else {*viewers} - relative
    for angle in ("theta", "phi"):
        # An angle without a side, beside one of the viewer, is the light's if the light has no other.
        if len(having(f"{angle}_out")) > 1 and not having(f"{angle}_in") and not relative:
            known |= {name: f"{angle}_in" for name in names if _ANGLES.get(name) == angle}
    if having("theta_out") and not having("theta_in") and not having("elevation_in"):
        sideless = [name for name in having("elevation_out") if _SIDES.keys().isdisjoint(name.split("_"))]
        known |= dict.fromkeys(sideless, "elevation_in")
    if _EXACT.keys() & {*having("value")}:
        ignored |= {*having("value")} - _EXACT.keys()
    if "R" in {cell.strip()[:1] for cell in cells} and not {"value", "green", "blue"} & {*known.values()}:
        known |= {name: "value" for name in names if name == "r"}  # Alone, R means reflectance.
    has_values = {"value", *CHANNELS} & {*known.values()} or any(map(wavelength_of, cells))
    if known.keys() >= {*"xyz"} and not has_values and {*units} <= {"", "deg", "rad", *VALUE_UNITS}:
        known |= {axis: f"cie_{axis}" for axis in "xyz"}
    for first in filter(_FIRST_OF_MATRIX.fullmatch, names):
        known[first] = "value"
        ignored.add(first.replace("00", "11"))
    return [None if name in ignored else known[name] for name in names]


def meaning_of(cell: str) -> str | None:
    """Return the meaning of a column with this name, or None if the name is unknown."""
    name, unit = name_and_unit(cell)
    return _meaning(name) or _meaning_by_unit(name, unit)


def _meaning_by_unit(name: str, unit: str) -> str | None:
    """Return the meaning of a name such as "incident [deg]" or "energy [eV]", whose unit says what it is."""
    if unit in RECIPROCAL_UNITS and name in {"frequency", "energy", "photon_energy"}:
        return "wavelength"
    return _meaning(f"{name}_angle") if unit in ANGLE_UNITS else None


@lru_cache(1 << 14)
def _meaning(name: str) -> str | None:
    """Return the meaning of a name in lower case: a known spelling, or words for an angle and for light or viewer."""
    if name in _EXACT:
        return _EXACT[name]
    if _EXACT.get("_".join(word for word in name.split("_") if word not in _QUALIFIERS)) == "value":
        return "value"
    written = list[str]()
    for word in name.split("_"):  # A word such as "thetai" or "dphi" has two parts.
        found = None if word in _ANGLES or word in _SIDES else _GLUED.fullmatch(word)
        written += found.groups() if found else (word,)
    words = [word for word in written if word not in _FILLERS]
    angles = [_ANGLES[word] for word in words if word in _ANGLES]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    n_relative = sum(word in _RELATIVE for word in words)
    if len(angles) + len(sides) + n_relative != len(words) or not words:
        return None
    is_short = words[-1] in _SHORT_ANGLES and (len(words) == 1 or words[0] in _SHORT_SIDES)
    if (angles, sides) == (["theta", "theta"], ["out", "in"]):
        return "theta_from_mirror"
    if is_short or len(angles) > 1 or len(sides) > 1:
        return None
    if n_relative:
        return "phi_out" if angles == ["phi"] else None
    if angles:
        return f"{angles[0]}_{sides[0] if sides else 'out'}"
    return f"theta_{sides[0]}" if len(written) > len(words) and len(words[0]) > 1 else None


def factor_of(cell: str, light: str) -> str:
    """Return a phrase on reflectance factors if the names of value and light suggest these; otherwise "".

    Values beside an angle of the sun are often reflectance factors, as in remote sensing.
    """
    name, is_solar = name_and_unit(cell)[0], re.match("s(?:un|ol|za)", name_and_unit(light)[0])
    if name in _RADIANCE_FACTORS:
        return "pi times the cosine of theta_in times the BRDF: if they are, set scale to 0.3183, and cosine to in"
    is_density = name.startswith((*_DENSITIES, "rrs"))
    is_factor = name == "r" or _FACTOR.fullmatch(name) is not None or (is_solar is not None and not is_density)
    return "pi times the BRDF: if they are, set scale to 0.3183, or to 0.003183 for per cent" if is_factor else ""


def includes_cosine(cell: str) -> bool:
    """Return whether a name of values means a BRDF times the cosine of theta_out."""
    return name_and_unit(cell)[0] in _TIMES_COSINE


def is_logarithm(cell: str) -> bool:
    """Return whether the name or the unit of a column says that its numbers are decibels or another logarithm."""
    name, unit = name_and_unit(cell)
    first, last = name.partition("_")[0], name.rpartition("_")[2]
    return any(_LOGARITHM.fullmatch(word) for word in (name, unit, first, last))


def matrix_names(cell: str) -> tuple[str, ...]:
    r"""Return the names in a cell such as "theta_out / theta_in" or "AOR \ AOI [deg]", the name of the rows first."""
    parts = [name_and_unit(part.strip("_ ")) for part in re.split(r"[/\\|]", cell)]
    if {_meaning(name) for name, _ in parts} not in _MATRICES or len(parts) != len(_MATRICES[0]):
        return ()
    units = [unit or ("" if _meaning(name) == "wavelength" else parts[-1][1]) for name, unit in parts]
    return tuple(f"{name} [{unit}]" if unit else name for (name, _), unit in zip(parts, units, strict=True))


def count_names(cells: Sequence[str], named: Collection[str] = ()) -> int:
    """Count the cells that are a known column name; `named` has additional names in lower case.

    Wavelengths count as names if there are several, and if at least one cell of the line is more than a number.
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
    return number if MIN_BAND_NM <= number <= MAX_BAND_NM else None


def constants_in(line: str) -> dict[str, float]:
    """Return the numbers that a line such as "#intheta 30" or "AOI [deg]: 30" states for all rows below the line."""
    parts = re.split(r"[,;]\s*(?=[^\W\d])", line[:_MAX_NAME_LENGTH])
    if len(parts) > 1:
        each = [constants_in(part) for part in parts]
        return {name: number for part in each for name, number in part.items()} if all(each) else {}
    found = _CONSTANT.fullmatch(_DECIMAL_COMMA.sub(r"\1.\2", line)) if len(line) <= _MAX_NAME_LENGTH else None
    if found is None:
        return {}
    name, unit = name_and_unit(found[1])
    meaning = _meaning(name)
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
    return _name_and_unit(cell) if len(cell) <= _MAX_NAME_LENGTH else (cell, "")


@lru_cache(maxsize=1024)  # The search for the column names asks for each cell about ten times.
def _name_and_unit(cell: str) -> tuple[str, str]:
    text, unit = unicodedata.normalize("NFKC", cell).strip(), ""
    text = re.sub(r"(?<=[a-z])(?=[A-Z])(?![BV]\b)", "_", text).lower()  # dB and eV are units.
    for letter, word in _GREEK.items():
        text = text.replace(letter, word)
    text = _MARKUP.sub("", text).strip()
    if _PRODUCT.fullmatch(text):
        return "ccbrdf", ""
    found = _COSINE.fullmatch(text)
    if found and (_meaning(name := name_and_unit(found[1] or found[2])[0]) or "").startswith("theta"):
        return name, COSINE
    bracket = min((place for mark in "[(" if (place := text.find(mark)) >= 0), default=-1)
    if bracket >= 0 and text.endswith(("]", ")")):
        text, unit = text[:bracket].rstrip(" /"), text[bracket + 1 : -1].strip()
        if found := _BAND_IN_BRACKETS.fullmatch(unit):
            text, unit = f"{text}_{found[1]}", ""
    elif found := _UNIT_BEHIND.fullmatch(text):
        text, unit = found[1], found[2] or found[3]
    name = re.sub(r"[\s.,-]+", "_", text)
    base, _, last = name.rpartition("_")
    is_unit = last in {*ANGLE_UNITS, *RECIPROCAL_UNITS} or (last in WAVELENGTH_UNITS and base in _OTHERS["wavelength"])
    return (base, last) if is_unit else (name, unit.replace("\N{MINUS SIGN}", "-"))
