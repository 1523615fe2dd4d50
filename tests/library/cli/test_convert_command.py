"""``dsbrdf convert``."""

from pathlib import Path

import numpy as np
import pytest

from dsbrdf.cli.main import main
from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.merl import read_merl
from dsbrdf.data.tensor_file import parse_tensors
from dsbrdf.output.export.rgl import rgl_bsdf
from tests.support.mixtures import mixture


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


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.bsdf", b"tensor_file\0\x01\x00", "a.bsdf: The tensor file is damaged or cut off"),
        ("a.csv", b"red\n", "a.csv: The first line of the table must name its columns"),
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
