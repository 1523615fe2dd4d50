"""``dsbrdf convert``."""

from pathlib import Path

import pytest

from dsbrdf.cli.main import main
from dsbrdf.data.tensor_file import parse_tensors


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
