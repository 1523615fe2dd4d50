"""The fits of measured materials that come with the package."""

from pathlib import Path

import numpy as np
import pytest

import dsbrdf
from dsbrdf import InvalidArgumentError
from dsbrdf.output.atlas import FOLDER
from tests.support.command_line import document, printed


@pytest.mark.parametrize("name", dsbrdf.materials())
def test_each_fit_is_close_to_its_measurement_and_conserves_energy(name: str) -> None:
    result = dsbrdf.load_material(name)
    assert (result.report.metrics.psnr or 0.0) > (24.0 if name == "chm_mint" else 40.0)
    assert np.all(result.model.albedo(np.radians([0.0, 60.0])) < 1.0)


def test_there_are_nine_small_files_with_their_origin() -> None:
    assert len(dsbrdf.materials()) == 9
    assert sum(path.stat().st_size for path in FOLDER.glob("*.json")) < 110_000
    assert "CC0" in (FOLDER / "README.md").read_text()
    with pytest.raises(InvalidArgumentError, match="no material 'gold'; a material is acrylic_felt_pink, aurora_white"):
        dsbrdf.load_material("gold")


def test_the_command_lists_them_and_writes_one(tmp_path: Path) -> None:
    assert [line.split()[0] for line in printed("materials").splitlines()[1:]] == list(dsbrdf.materials())
    assert [item["name"] for item in document("materials", "--json")["items"]] == list(dsbrdf.materials())
    assert "satin_purple" in printed("materials", "satin_purple", "-o", tmp_path / "paint.json")
    assert dsbrdf.load(tmp_path / "paint.json") == dsbrdf.load_material("satin_purple")
