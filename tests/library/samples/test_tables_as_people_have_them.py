"""Tables with what laboratories leave in them, of known truth: read right, or told what is wrong and what helps."""

from pathlib import Path

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError, ScatteredSamples, TableOptions, read_samples
from dsbrdf.arrays import Array, Mask
from dsbrdf.data import CHANNELS, half_difference
from dsbrdf.samples.doubts import sample_doubts
from dsbrdf.samples.names import VECTORS
from dsbrdf.samples.reading import parse_samples
from tests.library.samples.test_layouts import truth
from tests.library.samples.test_reading import ANGLES, COUNT, DIRECTION, RGB, changed, spherical, table

NAMES = ("theta_in", "phi_in", "theta_out", "phi_out", "value")
GRID = np.array([(a, 180.0, b, p) for a in (15.0, 40.0, 65.0) for b in range(0, 86, 5) for p in range(0, 181, 20)])
"""theta_in, phi_in, theta_out, phi_out [degrees]."""
TRUE = 0.1 * truth(*spherical(GRID))[:, 0]
"""A dark, rough material [1/sr]."""


def read(values: Array, number: str = "{:.6g}", grid: Array = GRID) -> ScatteredSamples:
    return parse_samples(table(NAMES, np.column_stack([grid, values]), number=number.format))


def test_zeros_beyond_the_reach_of_an_instrument_are_left_out_and_said() -> None:
    unseen = GRID[:, 2] > 0.9 * 85.0 - 0.1 * GRID[:, 3] / 20.0
    samples = read(np.where(unseen, 0.0, TRUE))
    assert len(samples.values) == np.count_nonzero(~unseen)
    assert f"{np.count_nonzero(unseen)} samples have the value 0 beside samples of 0.0" in samples.notes[-1]
    assert not sample_doubts(samples).sentences


def test_values_below_a_floor_that_are_written_as_0_are_left_out() -> None:
    falling = 0.02 * np.exp(-GRID[:, 2] / 9.0)
    samples = read(np.where(falling < 5e-5, 0.0, falling))
    assert samples.values.min() >= 5e-5
    assert "as instruments write where they measure nothing" in samples.notes[-1]


def test_a_pair_of_directions_may_be_turned_about_the_normal() -> None:
    """Materials are isotropic: whatever azimuth the lamp has, rows are left out and doubted alike."""
    turn = np.random.default_rng(3).uniform(0.0, 360.0, (len(GRID), 1)).round(3)
    turned = (GRID + turn * [0.0, 1.0, 0.0, 1.0]) % 360.0
    unseen = GRID[:, 2] > 0.9 * 85.0 - 0.1 * GRID[:, 3] / 20.0
    for values in (TRUE, np.where(unseen, 0.0, TRUE), np.minimum(TRUE, np.quantile(TRUE, 0.9)), 100.0 * np.pi * TRUE):
        samples, other = read(values), read(values, grid=turned)
        np.testing.assert_array_equal(other.values, samples.values)
        assert other.notes == samples.notes
        assert sample_doubts(other).sentences == sample_doubts(samples).sentences


@pytest.mark.parametrize("kind", ["few digits", "noise"])
def test_true_zeros_of_a_black_sample_are_kept(kind: str) -> None:
    noise = 3e-4 * np.random.default_rng(2).standard_normal(len(GRID))
    falling = 0.02 * np.exp(-GRID[:, 2] / 9.0)
    samples = read(falling, "{:.4f}") if kind == "few digits" else read(np.maximum(2e-4 + noise, 0.0))
    assert len(samples.values) == len(GRID)
    assert np.count_nonzero(samples.values[:, 0] == 0.0) > 50


def test_one_stray_sample_at_an_incidence_of_its_own_is_no_reason_to_doubt_the_unit() -> None:
    far = GRID[(GRID[:, 0] == 65.0) & (GRID[:, 2] >= 55.0)]
    rows = np.vstack([far, [15.0, 180.0, 80.0, 60.0]])
    values = np.append(np.full(len(far), 0.1), 30.0)
    assert not sample_doubts(parse_samples(table(NAMES, np.column_stack([rows, values])))).sentences


def test_equal_peaks_a_code_and_few_levels_are_no_saturated_detector() -> None:
    assert not sample_doubts(read(TRUE)).findings
    grid = np.vstack([GRID, np.add(GRID, [5.0, 0.0, 0.0, 0.0])])
    sharp = 0.01 + 0.04 * np.exp(-((half_difference(*spherical(grid))[0] / 0.06) ** 2))
    assert not sample_doubts(read(sharp, grid=grid)).findings
    assert sample_doubts(read(np.where(np.arange(len(TRUE)) % 9, TRUE, 99999.0))).findings[0].code == "doubtful-table"
    rough = np.minimum(TRUE, np.quantile(TRUE, 0.9)).round(2)
    assert not any("clipped" in sentence for sentence in sample_doubts(read(rough)).sentences)


def test_logarithms_without_a_word_are_told() -> None:
    with pytest.raises(MeasurementFormatError, match=r"Most values are negative, .* if they are decibels"):
        read(10.0 * np.log10(TRUE))


def test_noise_of_a_grey_spectrum_is_no_colour() -> None:
    bands = np.arange(400.0, 701.0, 20.0)
    names = (*NAMES[:-1], *(f"{band:g} nm" for band in bands))
    noise = np.where(np.arange(len(GRID)) == 55, -1e-4, TRUE)[:, None] * np.ones(bands.size)
    assert "1 value is negative" in parse_samples(table(names, np.hstack([GRID, noise]))).notes[-1]


def test_one_bright_sample_in_each_mirror_direction_is_told_and_no_unit_is_doubted() -> None:
    anywhere = np.column_stack([ANGLES[:, 0], np.full(COUNT, 180.0), ANGLES[:, 2:]])
    half, of_random = np.degrees(half_difference(*spherical(GRID))[0]), 0.1 * truth(*spherical(anywhere))[:, 0]

    def told(kept: Mask, bright: Mask, *others: tuple[Array, Array]) -> tuple[str, ...]:
        grids, values = zip((GRID[kept], np.where(bright, 90.0, TRUE)[kept]), *others, strict=True)
        return sample_doubts(read(np.concatenate(values), grid=np.vstack(grids))).sentences

    every, first = np.ones(len(GRID), bool), GRID[:, 0] == 15.0
    (said,) = told(every, half < 1e-3)
    assert said.startswith("At 3 angles of incidence one sample alone lies in the highlight: it is up to ")
    assert "not its width: measure between them" in said
    for others in (
        told(every, first & (half < 1e-3)),  # a glint at one of the incidences
        told(half > 4.0, half < 5.01),  # no sample near the mirror direction
        told(first, half < 1e-3, (anywhere, of_random)),  # hardly any incidence occurs twice
    ):
        assert "one sample alone" not in " ".join(others)


def test_exchanged_angles_are_told_with_the_option_that_exchanges_them() -> None:
    content = table(("phi_i", "theta_i", "phi_o", "theta_o", "brdf"), np.column_stack([GRID, TRUE]))
    said = "exchanged, name them, as in --columns theta_in=phi_i,theta_out="
    with pytest.raises(MeasurementFormatError, match=said) as caught:
        parse_samples(content)
    option = str(caught.value).rpartition(" ")[2].rstrip(".")
    samples = parse_samples(content, options=TableOptions(columns=option))
    np.testing.assert_allclose(samples.omega_out, spherical(GRID)[1], atol=1e-9)


def test_several_materials_in_one_table_are_told() -> None:
    rows = [",".join([name, *map(repr, row)]) for row in GRID[:, :3].tolist() for name in ("B", "G")]
    content = "\n".join(["paint,theta_in,phi_in,theta_out", *rows]).encode()
    samples = parse_samples(content, options=TableOptions(columns="value=phi_in"))
    assert "The column 'paint' has 2 values, such as 'B' and 'G': if they are several materials" in samples.notes[2]


SUN = np.column_stack([GRID[:, 2:], GRID[:, :2]])
"""theta_out, phi_out, theta_in, phi_in [degrees]."""


def test_a_name_too_many_after_a_label_is_told() -> None:
    """The last name could be that of a column which the rows leave out."""
    content = table("# columns vza vaa sza saa 520 640 sigma", np.column_stack([SUN, TRUE, TRUE, TRUE]), between=" ")
    with pytest.raises(MeasurementFormatError, match=r"Line 2 of the table has 7 cells, .* names has 8"):
        parse_samples(content)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (
            (*DIRECTION, "I/F"),
            "are pi times the cosine of theta_in times the BRDF: if they are, set scale to 0.3183, and",
        ),
        ((*DIRECTION, "BRF"), "are pi times the BRDF: if they are, set scale to 0.3183, or to 0.003183 for per cent"),
        (("SZA", "SAA", "VZA", "VAA", "band"), "are pi times the BRDF: if they are, set scale to 0.3183"),
        (("SZA", "SAA", "VZA", "VAA", "BRDF"), ""),
    ],
)
def test_reflectance_and_radiance_factors_are_told_with_the_options(names: tuple[str, ...], words: str) -> None:
    options = TableOptions(columns=f"value={names[4]}")
    samples = parse_samples(table(names, np.column_stack([GRID, TRUE])), options=options)
    assert words in samples.notes[0] if words else not any("factors" in note for note in samples.notes)


def test_colours_in_cie_xyz_are_read() -> None:
    white, red = np.array([0.9505, 1.0, 1.089]), np.array([0.4124, 0.2126, 0.0193])  # IEC 61966-2-1.
    for colour, expected in ((white, [1.0, 1.0, 1.0]), (red, [1.0, 0.0, 0.0])):
        at_40 = GRID[:, 0] == 40.0
        columns = np.column_stack([GRID[at_40, 2:], TRUE[at_40, None] * colour])
        head = "#incident_angle 40 180\n#colorimetry: CIE-XYZ\n"
        pgii = parse_samples(table("#format: theta phi BSDF", columns, between=" ", before=head))
        named = parse_samples(table((*DIRECTION, "X", "Y", "Z"), np.column_stack([GRID, TRUE[:, None] * colour])))
        np.testing.assert_allclose(pgii.values, TRUE[at_40, None] * expected, atol=2e-4 * TRUE.max())
        np.testing.assert_allclose(named.values, TRUE[:, None] * expected, atol=2e-4 * TRUE.max())


def test_one_visible_band_is_told_and_the_others_have_no_part() -> None:
    for names in ("vza,vaa,sza,saa,655 nm,865 nm,1610 nm", "vza,vaa,sza,saa,865 nm,655 nm,1610 nm"):
        at = names.split(",").index("655 nm")
        columns = np.column_stack([SUN, 30.0 * TRUE, 30.0 * TRUE, 9.0 * TRUE])
        columns[:, at] = TRUE
        samples = parse_samples(table(names, columns))
        np.testing.assert_allclose(samples.values, np.repeat(TRUE[:, None], 3, axis=1), rtol=1e-6)
        assert "Only one of the 3 wavelengths is visible, 655 nm: " in samples.notes[-1]
    samples = parse_samples(table("vza,vaa,sza,saa,500 nm,655 nm,865 nm", columns))
    assert samples.notes[-1].startswith("Most of blue is extrapolated: beyond the wavelengths of the table")


@pytest.mark.parametrize("name", ["BRDF [dB]", "log10(BRDF)", "brdf_dB", "ln BRDF", "10*log10(fr)"])
def test_logarithms_are_refused_in_the_words_of_the_file(name: str) -> None:
    content = table((*DIRECTION, name), np.column_stack([GRID, 10.0 * np.log10(TRUE)]))
    with pytest.raises(MeasurementFormatError, match="has logarithms of the values, as decibels or log10") as caught:
        parse_samples(content)
    assert f"The column {name!r} has" in str(caught.value)


def test_no_example_is_given_that_does_not_read_the_table() -> None:
    spectrum = b"\n".join(b"%.2f,%.3f" % (0.4 + 0.01 * at, 0.2 + 0.003 * at) for at in range(60))
    factors = table("", np.column_stack([np.arange(380.0, 740.0, 5.0), *[np.linspace(0.1, 0.9, 72)] * 3]))
    for content, words in ((spectrum, "which a spectrum does not have."), (factors, "as MEANING=POSITION.")):
        with pytest.raises(MeasurementFormatError, match="has no line that names its columns") as caught:
            parse_samples(content)
        assert str(caught.value).endswith(words)
    scan = table("", np.column_stack([GRID[:, 2:], TRUE])[GRID[:, 0] == 40.0], between=" ")
    with pytest.raises(MeasurementFormatError) as caught:
        parse_samples(scan)
    example = str(caught.value).partition("--columns ")[2].split(" ")
    assert example[:3] == ["theta_out=1,phi_out=2,value=3", "--constants", "theta_in=30"]
    assert len(parse_samples(scan, options=TableOptions(columns=example[0], constants=example[2])).values) == 180


@pytest.mark.parametrize("names", ["theta_i,phi_i,theta_t,phi_t,BTDF", "theta_i,phi_i,theta_r,phi_r,L*,a*,b*"])
def test_what_is_no_reflection_or_no_linear_colour_is_told(names: str) -> None:
    content = table(names, np.column_stack([GRID, TRUE, TRUE, TRUE])[:, : names.count(",") + 1])
    with pytest.raises(MeasurementFormatError, match=r"light is not read|colours must be linear sRGB or CIE XYZ"):
        parse_samples(content)


MISLEADING = (
    ("theta_in;theta_out;BRDF;side", ("0.1;front", "0.2;back"), "among both sides of the sample, such as 'back'"),
    ("theta_in;theta_out;BRDF;mode", ("0.1;R", "0.2;T"), "among both sides of the sample, such as 'T'"),
    ("theta_in;theta_out;BRDF;side", ("0.1;1", "0.2;-1"), "divides the rows among both sides of the sample"),
    (
        "theta_in;theta_out;BRDF;phi_out",
        ("0.1;0", "0.2;200"),
        "200, half a turn in gradians: name the column phi_out_gon",
    ),
    (
        "theta_in;theta_out;BRDF;phi_out",
        ("0.1;0", "0.2;400"),
        "If it has another unit, name it phi_out_rad or phi_out_",
    ),
    (
        "# angles in gradians\ntheta_in;theta_out;BRDF",
        ("0.1", "0.2"),
        "file names gradians, but no column has this unit",
    ),
    (
        "theta_in;probe;BRDF;scatter angle",
        ("0.1;20", "0.2;140"),
        "angles up to 140 degrees, as between light and viewer",
    ),
    ("theta_in;theta_out;450 nm;0.45 um", ("0.1;0.1", "0.2;0.3"), "'450 nm' and '0.45 um' both seem to be at 450 nm"),
    ("theta_in;theta_out;BRDF", ("1,234", "987.6"), "a comma or a point may separate thousands, as in '1,234'"),
    ("theta_in;theta_out;BRDF", ("1,234", "987"), "a comma or a point may separate thousands, as in '1,234'"),
    ("theta_in_rad;theta_out;BRDF", ("0.1", "0.2"), r"3724\.23 degrees; 180 is the largest that there is\.$"),
    ("theta_in;theta_out;absorptance", ("0.1", "0.2"), "emitted light is not read, only reflected light"),
)


@pytest.mark.parametrize(("names", "cells", "said"), MISLEADING)
def test_a_column_that_could_be_misread_is_refused(names: str, cells: tuple[str, str], said: str) -> None:
    rows = [f"{a:g};{b:g};{cells[at % 2]}" for at, (a, _, b, _) in enumerate(GRID)]
    with pytest.raises(MeasurementFormatError, match=said):
        parse_samples("\n".join([names, *rows]).encode())


@pytest.mark.parametrize(
    "names", ["# angles in gradians\ntheta_in_deg;theta_out_deg;BRDF", "# GON\ntheta_in;theta_out;BRDF"]
)
def test_a_comment_or_a_constant_side_changes_nothing(names: str) -> None:
    rows = [f"{a:g};{b:g};{value:g};back" for (a, _, b, _), value in zip(GRID, TRUE, strict=True)]
    assert len(parse_samples("\n".join([f"{names};side", *rows]).encode()).values) > 0


def test_files_of_one_material_are_told_of_together(tmp_path: Path) -> None:
    paths = [tmp_path / f"at{angle:g}.txt" for angle in (15.0, 40.0)]
    for path, angle in zip(paths, (15.0, 40.0), strict=True):
        rows = np.column_stack([GRID[:, 2:], TRUE])[GRID[:, 0] == angle]
        low = [[95.0, 0.0, 0.1]] if angle == 15.0 else [[95.0, 0.0, 0.1], [91.0, 0.0, 0.1]]
        columns = np.vstack([rows, low])
        path.write_bytes(table("#format: theta phi BSDF", columns, between=" ", before=f"#intheta {angle}\n"))
    samples = read_samples(paths)
    assert len(samples.values) == 360
    assert "3 rows have a direction at or below the horizon; they are left out." in samples.notes
    assert not any("15" in note or "40" in note for note in samples.notes)
    paths[1].write_bytes(table((*DIRECTION, *CHANNELS), np.column_stack([GRID, TRUE, TRUE, 0.5 * TRUE])))
    with pytest.raises(MeasurementFormatError, match=r"The file at15\.txt has one column of values, and other files"):
        read_samples(paths)


@pytest.mark.parametrize("word", ["#N/A", "#DIV/0!", "-nan(ind)", "1.#INF", "missing", "n.a.", "---"])
def test_words_for_no_number_leave_out_their_row(word: str) -> None:
    samples = parse_samples(changed(5, word))
    assert len(samples.values) == COUNT - 1
    assert samples.notes == ("1 row has no finite number in a column that is needed, such as 'green'; it is left out.",)


def test_vectors_one_percent_off_are_made_unit_vectors() -> None:
    first, second = spherical(ANGLES)
    samples = parse_samples(table((*VECTORS, *CHANNELS), np.hstack([1.01 * first, second, RGB])))
    np.testing.assert_allclose(np.linalg.norm(samples.omega_in, axis=1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(samples.omega_in, first, atol=1e-8)
    assert samples.notes == ("The vectors omega_in were up to 1.0% off unit length; they were made unit vectors.",)


def test_values_of_one_pair_of_directions_that_are_far_apart_are_told() -> None:
    rows = np.hstack([ANGLES, RGB])
    again = rows[10:40] * [1.0, 1.0, 1.0, 1.0, 1.02, 1.02, 1.02]
    assert not parse_samples(table(columns=np.vstack([rows, again]))).notes
    again[[3, 7], 4:] *= [[1.5], [0.6]]
    again[3] -= [0.0, 360.0, 0.0, 360.0, 0.0, 0.0, 0.0]
    (note,) = parse_samples(table(columns=np.vstack([rows, again]))).notes
    assert note.startswith("2 pairs of directions have values that differ by more than 25%, such as theta_in = ")
