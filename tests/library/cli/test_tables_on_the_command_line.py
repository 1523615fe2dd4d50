"""Tables of samples on the command line: the options that say how they are read."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from dsbrdf import TableOptions, read_merl, read_samples, save
from dsbrdf.engines import batch
from dsbrdf.samples.names import VECTORS
from tests.library.samples.test_layouts import LAYOUTS, MIRROR_60
from tests.support.command_line import document, load_fit, printed, run
from tests.support.models import mixture, scattered_samples
from tests.support.soak import repeats

pytestmark = pytest.mark.slow


def test_the_options_of_a_table_are_flags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    felt = mixture(1, 0)
    samples = scattered_samples(felt, 60)
    values = np.where(np.arange(60)[:, None] % 9 == 0, -999.0, 100.0 * samples.values * samples.omega_out[:, 2:])
    rows = np.hstack([samples.omega_in * [-1.0, -1.0, 1.0], samples.omega_out, values])
    odd = tmp_path / "odd.csv"
    np.savetxt(odd, rows, delimiter=",", header=",".join((*VECTORS, "red", "green", "azure")), comments="")
    flags = ("--columns", "blue=azure", "--missing", "-999", "--scale", "0.01", "--cosine", "out", "--phi", "mirror")
    found = document("fit", odd, "-o", tmp_path, "--n-lobes", "1", "--ring-lobes", "0", *flags, "--json")
    error = found["report"]["metrics"]["relative_rms"]
    stored = load_fit(tmp_path / "odd.json")
    model, report = stored.model, stored.report
    angles = np.radians(10.0), np.radians(30.0)
    np.testing.assert_allclose(model.evaluate(*angles), felt.evaluate(*angles), rtol=0.02)
    chosen = TableOptions(columns="blue=azure", missing=-999, scale=0.01, cosine="out", phi="mirror")
    assert report.samples == read_samples(odd, chosen).sha256
    plan = ("--measure-next", tmp_path / "plan.csv", "--next-step", "5", "--max-theta", "60")
    kept = document("fit", odd, "-o", tmp_path, "--n-lobes", "1", "--ring-lobes", "0", *flags, *plan, "--json")
    assert kept["resumed"]
    names, *lines = (tmp_path / "plan.csv").read_text().splitlines()
    assert names.split(",") == [*VECTORS, "red", "green", "azure"]
    heights = np.array([[float(cell) for cell in row.split(",")[2:6:3]] for row in lines])
    assert heights.min() > 0.4999
    np.testing.assert_allclose(np.degrees(np.arccos(heights)) % 5.0 % 4.9999, 0.0, atol=1e-3)
    assert "beside what was measured" in printed("plot", tmp_path / "odd.json", odd, "-o", tmp_path / "odd.png", *flags)
    compared = document("compare", tmp_path / "odd.json", odd, *flags, "--json")
    assert compared["likeness"]["relative_rms"] == pytest.approx(error, rel=0.05)  # It leaves grazing angles out.
    assert "error of the fit " in printed("convert", odd, tmp_path / "odd.binary", *flags)
    at_node = read_merl(tmp_path / "odd.binary").values[:, 30, 30, 90]  # theta_half 10, theta_diff 30 degrees
    np.testing.assert_allclose(at_node, felt.evaluate(*angles), rtol=0.05)
    monkeypatch.setattr(batch, "run_step", lambda *_: 1 // 0)
    with pytest.raises(ZeroDivisionError):  # With another scale it is another measurement, to be fitted anew.
        run("fit", odd, "-o", tmp_path, "--n-lobes", "1", "--ring-lobes", "0", *flags[:5], "0.005", *flags[6:])


def test_layouts_of_instruments_are_fitted_to_their_truth(tmp_path: Path) -> None:
    """Of some, no sample is near: a needle of a highlight that no sample sees would be 500 times as bright."""
    files = sorted(LAYOUTS.iterdir())[:: repeats(18, 1)]
    run("fit", *files, "-o", tmp_path, "--n-lobes", "2", "--ring-lobes", "0")
    out = np.array([np.sin(np.radians(60.0)), 0.0, np.cos(np.radians(60.0))])
    for path in files:
        model = load_fit(tmp_path / f"{path.stem}.json").model
        value = model.evaluate_directions(out * [-1.0, 1.0, 1.0], out)
        assert value == pytest.approx([MIRROR_60] * 3, rel=0.3), path.name


def test_what_was_made_of_a_measurement_is_replaced_and_no_pipe_is_read(tmp_path: Path) -> None:
    shutil.copy(LAYOUTS / "vectors.csv", tmp_path / "a.csv")
    save(mixture(1, 0), tmp_path / "c.json")
    for _ in range(2):
        run("convert", tmp_path / "a.csv", tmp_path / "made.csv")
        run("export", tmp_path / "c.json", "-o", tmp_path / "c.csv")
    os.mkfifo(tmp_path / "pipe")
    assert "A pipe or a device can be read only once" in run("fit", tmp_path / "pipe", code=2).stderr
