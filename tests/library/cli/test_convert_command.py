"""``dsbrdf convert``."""

import json
from pathlib import Path

import numpy as np
import pytest

from dsbrdf.cli.main import main
from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.merl import read_merl
from dsbrdf.data.sample_columns import VECTORS
from dsbrdf.data.tensor_file import encode_tensors, parse_tensors
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export.rgl import rgl_bsdf
from tests.support.mixtures import mixture, scattered_samples


def test_a_measurement_becomes_a_bsdf_file(plastic_file: Path, tmp_path: Path) -> None:
    output = tmp_path / "plastic.bsdf"
    assert main(["convert", str(plastic_file), str(output)]) == 0
    fields = parse_tensors(output.read_bytes())
    assert fields["rgb"].shape[2] == 3
    assert fields["rgb"].min() >= 0.0


def test_a_merl_file_is_copied_bit_for_bit(plastic_file: Path, tmp_path: Path) -> None:
    output = tmp_path / "copy.binary"
    assert main(["convert", str(plastic_file), str(output)]) == 0
    assert output.read_bytes() == plastic_file.read_bytes()


def test_bad_input_is_one_sentence_and_writes_nothing(
    plastic_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = tmp_path / "short.binary"
    short.write_bytes(plastic_file.read_bytes()[:1000])
    for source, target, words in (
        (plastic_file, "out.png", "the output must end in .binary or .bsdf"),
        (short, "out.bsdf", "short.binary"),
        (tmp_path / "none.binary", "out.bsdf", "none.binary"),
    ):
        assert main(["convert", str(source), str(tmp_path / target)]) == 2
        message = capsys.readouterr().err
        assert words in message
        assert message.count("\n") == 1
        assert not (tmp_path / target).exists()


def test_an_rgl_file_becomes_a_merl_file(tmp_path: Path) -> None:
    source, output = tmp_path / "paint.bsdf", tmp_path / "paint.binary"
    source.write_bytes(rgl_bsdf(mixture(2, 1)))
    assert main(["convert", str(source), str(output)]) == 0
    measurement = read_merl(output)
    expected = mixture(2, 1).evaluate(THETA_HALF[20], THETA_DIFF[30], PHI_DIFF[90])
    np.testing.assert_allclose(measurement.values[:, 20, 30, 90], expected, rtol=0.02)


def test_what_a_merl_table_cannot_hold_of_a_bsdf_file_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the second file one order of the directions is brighter: by a factor that grows with the first angle."""
    one = np.ones((1, 1, 1))
    wide = DSBRDF(np.zeros(1), amplitude=0.2 * np.ones((3, 1, 1)), kappa=one, gamma=one)
    for name, growth in (("paint", 0.0), ("one-way", 1.5)):
        fields = dict(parse_tensors(rgl_bsdf(wide)))
        factor = 1.0 + growth * fields["theta_i"]
        fields["rgb"] = (fields["rgb"] * factor[:, None, None, None]).astype(np.float32)
        (tmp_path / f"{name}.bsdf").write_bytes(encode_tensors(fields))
        command = ["convert", str(tmp_path / f"{name}.bsdf"), str(tmp_path / f"{name}.binary")]
        assert main(command) == 0
        printed = capsys.readouterr()
        assert "non reciprocity " in printed.out
        assert ("warning: " in printed.err) is (growth > 0.0)
        assert main([*command, "--json"]) == 0
        difference = json.loads(capsys.readouterr().out)["non_reciprocity"]
        expected = expected_difference(growth)
        assert difference == pytest.approx(expected, abs=0.02)


def expected_difference(growth: float) -> float:
    """Median of 2 |a - b| / (a + b) of the factors at two angles whose cosines are spread evenly."""
    cosine = np.random.default_rng(7).uniform(np.cos(np.radians(75.0)), 1.0, (2, 100_000))
    factor = 1.0 + growth * np.arccos(cosine)
    near = np.random.default_rng(8).random(cosine.shape[1]) < 0.25  # mirror pairs have equal angles
    difference = np.where(near, 0.0, 2.0 * np.abs(factor[0] - factor[1]) / factor.sum(axis=0))
    return float(np.median(difference))


def test_a_bsdf_file_loses_nothing_in_a_bsdf_file(tmp_path: Path) -> None:
    source = tmp_path / "paint.bsdf"
    source.write_bytes(rgl_bsdf(mixture(2, 1)))
    assert main(["convert", str(source), str(tmp_path / "copy.bsdf")]) == 0
    assert (tmp_path / "copy.bsdf").read_bytes() == source.read_bytes()
    assert main(["convert", str(source), str(tmp_path / "spectral.bsdf"), "--spectral"]) == 0
    assert "spectra" in parse_tensors((tmp_path / "spectral.bsdf").read_bytes())


def test_a_table_is_fitted_and_its_fit_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = mixture(1, 0)
    samples = scattered_samples(truth, 600)
    names = ",".join((*VECTORS, "red", "green", "blue"))
    columns = np.hstack([samples.omega_in, samples.omega_out, samples.values])
    np.savetxt(tmp_path / "felt.csv", columns, delimiter=",", header=names, comments="")
    assert main(["convert", str(tmp_path / "felt.csv"), str(tmp_path / "felt.binary")]) == 0
    assert "error of the fit " in capsys.readouterr().out
    found = read_merl(tmp_path / "felt.binary").values[:, 30, 20, 90]
    np.testing.assert_allclose(found, truth.evaluate(THETA_HALF[30], THETA_DIFF[20], PHI_DIFF[90]), rtol=0.05)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.bsdf", b"tensor_file\0\x01\x00", "a.bsdf: The tensor file is damaged or cut off"),
        ("a.csv", b"red\n", "a.csv: The table lacks columns for the directions: theta_in, theta_out. It has red."),
    ],
)
def test_a_bad_file_of_another_kind_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: bytes, words: str
) -> None:
    (tmp_path / name).write_bytes(content)
    for command in (["convert", name, "b.binary"], ["render", name, "-o", "b.png"], ["fit", name, "-o", "fits"]):
        words_of_command = [str(tmp_path / word) if "." in word or word == "fits" else word for word in command]
        assert main(words_of_command) == 2
        message = capsys.readouterr().err
        assert words in message
        assert message.count("\n") == 1
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == [name]
