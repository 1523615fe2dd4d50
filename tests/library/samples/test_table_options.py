"""Options that say of a table what it does not say itself, and the names that say it."""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import dsbrdf
from dsbrdf import InvalidArgumentError, MeasurementFormatError, TableOptions
from dsbrdf.data.merl_validation import HEADER
from dsbrdf.samples.reading import parse_samples
from tests.library.samples.test_reading import ANGLES, COUNT, GREY, RGB, check_same, table

DIRECTION = ("theta_in", "phi_in", "theta_out", "phi_out")
NAMED = {"theta_in": "AOI 1", "phi_in": "turn", "theta_out": "Arm", "phi_out": "tilt", "value": "Signal"}
ODD = table(list(NAMED.values()), np.hstack([ANGLES, GREY[:, :1]]))


@pytest.mark.parametrize("columns", [NAMED, ",".join(f"{meaning}={name.upper()}" for meaning, name in NAMED.items())])
def test_columns_are_named(columns: str) -> None:
    check_same(parse_samples(ODD, options=TableOptions(columns=columns)), ANGLES, GREY)


def test_a_column_that_is_named_counts_alone() -> None:
    columns = np.hstack([ANGLES, 2.0 * GREY[:, :1], GREY[:, :1]])
    samples = parse_samples(table((*DIRECTION, "BSDF", "BRDF"), columns), options=TableOptions(columns="value=BRDF"))
    check_same(samples, ANGLES, GREY)
    swapped = TableOptions(columns="theta_in=theta_out,theta_out=theta_in,phi_in=phi_out,phi_out=phi_in")
    check_same(parse_samples(table(), options=swapped), ANGLES[:, [2, 3, 0, 1]], RGB)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ("theta_in=angle", "The table has no column 'angle'; it has 'AOI 1', 'turn', 'Arm'"),
        ("theta_inn=Arm", "The option columns has 'theta_inn'; the meanings are theta_in, "),
    ],
)
def test_columns_that_are_not_there_are_told(columns: str, words: str) -> None:
    with pytest.raises(MeasurementFormatError) as caught:
        parse_samples(ODD, options=TableOptions(columns=f"value=Signal,{columns}"))
    assert words in str(caught.value)


@pytest.mark.parametrize(("side", "cosine"), [("in", 0), ("out", 2)])
def test_values_are_multiplied_and_divided_and_the_plane_is_turned(side: Literal["in", "out"], cosine: int) -> None:
    samples = parse_samples(table(), options=TableOptions(scale=0.01, cosine=side, phi="mirror"))
    turned = np.add(ANGLES, [0.0, 180.0, 0.0, 0.0])
    check_same(samples, turned, 0.01 * RGB / np.cos(np.radians(ANGLES[:, [cosine]])))


def test_a_mirror_direction_with_the_same_phi_is_turned() -> None:
    in_plane = ANGLES * [1.0, 0.0, 1.0, 0.0] + [0.0, 180.0, 0.0, 0.0]
    turned = table(("theta_in", "theta_out", "red", "green", "blue"), np.hstack([ANGLES[:, ::2] * [-1, 1], RGB]))
    samples = parse_samples(turned, options=TableOptions(phi="mirror"))
    check_same(samples, in_plane, RGB)
    assert "theta_out = -theta_in to be the mirror direction" in samples.notes[0]


def test_an_option_may_name_a_unit() -> None:
    content = table("lamp,turn,camera,aside,red,green,blue", np.hstack([np.radians(ANGLES), RGB]))
    columns = "theta_in_rad=lamp,phi_in_rad=2,theta_out_rad=camera,phi_out_rad=4"
    check_same(parse_samples(content, options=TableOptions(columns=columns)), ANGLES, RGB)


def test_a_file_is_read_with_options_and_a_grid_has_none(tmp_path: Path) -> None:
    path = tmp_path / "paint.csv"
    path.write_bytes(table())
    samples = dsbrdf.read_measurement(path, scale=0.5)
    check_same(samples, ANGLES, 0.5 * RGB)  # type: ignore[arg-type]
    (tmp_path / "paint.bin").write_bytes(HEADER + bytes(99))
    for options in (TableOptions(scale=0.5), TableOptions(scale=0.5, missing=0)):
        with pytest.raises(InvalidArgumentError, match=r"of a table of samples, and this is a MERL file: leave"):
            dsbrdf.fit(tmp_path / "paint.bin", scale=0.5, missing=options.missing)


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        ({"columns": "AOI"}, "columns must be such as theta_in=AOI,value=BSDF, not 'AOI'"),
        ({"columns": 3}, "columns must be such as"),
        ({"missing": "0"}, "missing must be finite numbers, not '0'"),
        ({"missing": [0, float("nan")]}, "missing must be finite numbers"),
        ({"missing": 10**400}, "missing must be finite numbers"),
        ({"scale": 0}, "scale must be a number from 1e-12 to 1e+12, not 0"),
        ({"scale": True}, "scale must be a number from 1e-12 to 1e+12, not True"),
        ({"phi": "turned"}, "phi must be one of mirror, not 'turned'"),
    ],
)
def test_options_are_checked_when_they_are_made(choice: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        TableOptions(**choice)  # type: ignore[arg-type]
    assert words in str(caught.value)


OF_INSTRUMENTS = {
    "AOI, AOR": ("AOI", "phi_i", "AOR", "phi_r"),
    "in words": ("Angle of incidence", "Incident azimuth", "Angle of reflection", "Azimuth"),
    "zenith angles": ("Illumination zenith angle (deg)", "Illumination azimuth", "View zenith (deg)", "View azimuth"),
    "of remote sensing": ("SZA", "SAA", "VZA", "VAA"),
    "Greek letters": ("θi [°]", "φi [°]", "θr [°]", "φr [°]"),
    "Greek letters and subscripts": ("Θ_i", "ϕᵢ", "Θ_r", "ϕᵣ"),
    "incident angle": ("incident angle", "phi_incident", "viewing angle", "phi"),
    "angles of a direction": ("Zenith angle of incidence (deg)", "Azimuth of incidence", "Emission angle", "phi_obs"),
    "camel case": ("incidentAngle", "lightAzimuth", "angleOut", "relativeAzimuth"),
    "shortened": ("Inc (deg)", "SunAzm", "Obs_deg", "ViewAzm"),
    "LaTeX": (r"$\theta_i$", r"$\phi_{i}$", r"$\theta_r$", r"$\phi_{r}$"),
    "glued": ("solz", "sola", "senz", "sena"),
    "of the ISO": ("θ_inc / °", "φ_inc / deg", "theta_ref / deg", "phi_ref"),
    "receiver": ("source polar", "source azimuth", "receiver polar", "receiver azimuth"),
}


@pytest.mark.parametrize("names", OF_INSTRUMENTS.values(), ids=OF_INSTRUMENTS.keys())
def test_names_of_instruments_are_known(names: tuple[str, ...]) -> None:
    check_same(parse_samples(table((*names, "BSDF (sr⁻¹)"), np.hstack([ANGLES, GREY[:, :1]]))), ANGLES, GREY)


def test_an_elevation_is_from_the_horizon() -> None:
    columns = np.hstack([np.abs([90.0, 0.0, 90.0, 0.0] - ANGLES), GREY[:, :1]])
    samples = parse_samples(table(("light elevation", "phi_in", "elevation", "azimuth", "value"), columns))
    check_same(samples, ANGLES, GREY)
    assert any("theta_out is 90 degrees minus it" in note for note in samples.notes)


@pytest.mark.parametrize(("missing", "which"), [(0.0, "smallest"), (9999.0, "largest")])
def test_a_value_that_stands_for_what_is_missing_is_left_out_or_named(missing: float, which: str) -> None:
    spoiled, rgb = np.arange(COUNT) % 9 == 0, RGB + 0.5
    content = table(columns=np.hstack([ANGLES, np.where(spoiled[:, None] * [1, 0, 0], missing, rgb)]))
    (note,) = parse_samples(content).notes
    assert note.startswith(f"27 samples have the same {which} value, {missing:g}, far from all others")
    check_same(parse_samples(content, options=TableOptions(missing=(-1, missing))), ANGLES[~spoiled], rgb[~spoiled])


def test_values_of_a_grey_table_are_counted_once() -> None:
    values = np.where(np.arange(COUNT) % 60 == 0, -0.002, GREY[:, 0])[:, None]
    notes = parse_samples(table((*DIRECTION, "value"), np.hstack([ANGLES, values]))).notes
    assert any(note.startswith("4 values are negative") for note in notes)
