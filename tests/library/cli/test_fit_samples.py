"""``dsbrdf fit`` of a table of scattered samples."""

import json
from pathlib import Path

import numpy as np
import pytest

from dsbrdf.cli.main import main
from dsbrdf.data.sample_columns import VECTORS
from dsbrdf.output.serialize import load_result
from tests.support.command_line import Capture
from tests.support.mixtures import mixture

TRUTH = mixture(1, 0)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    random = np.random.default_rng(0)
    cosine, turn = random.uniform(0.15, 1.0, (2, 1500)), random.uniform(0.0, 2.0 * np.pi, (2, 1500))
    sine = np.sqrt(1.0 - cosine**2)
    first, second = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1)
    path = tmp_path_factory.mktemp("samples") / "felt.csv"
    columns = [first, second, TRUTH.evaluate_directions(first, second)]
    head = ",".join((*VECTORS, "red", "green", "blue"))
    np.savetxt(path, np.hstack(columns), delimiter=",", header=head, comments="", fmt="%.9g")
    return path


def test_a_table_is_fitted_and_stored(table: Path, tmp_path: Path, capsys: Capture) -> None:
    command = ["fit", str(table), "-o", str(tmp_path), "--n-lobes", "1", "--ring-lobes", "0"]
    assert main([*command, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["metrics"]["relative_rms"] < 0.01
    assert document["metrics"]["psnr"] is None
    result = load_result(tmp_path / "felt.json")
    near = result.model.evaluate(np.radians(10.0), np.radians(30.0))
    np.testing.assert_allclose(near, TRUTH.evaluate(np.radians(10.0), np.radians(30.0)), rtol=0.02)
    assert main(command) == 0
    assert "(kept)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["fit", "felt.csv", "--method", "paper"], "cannot be fitted with method 'paper'"),
        (["render", "felt.csv", "-o", "a.png"], "felt.csv: scattered samples are no measurement on a grid"),
    ],
)
def test_what_samples_cannot_be_used_for_is_one_sentence(
    table: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture, command: list[str], words: str
) -> None:
    monkeypatch.chdir(table.parent)
    assert main(command) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert [path.name for path in table.parent.iterdir()] == ["felt.csv"]
