"""Tables of samples on the command line: the options that say how they are read."""

from pathlib import Path

import numpy as np
import pytest

from dsbrdf.data.sample_names import VECTORS
from dsbrdf.output.serialize import load_result
from tests.support.command_line import document, printed
from tests.support.mixtures import mixture, scattered_samples

pytestmark = pytest.mark.slow


def test_the_options_of_a_table_are_flags(tmp_path: Path) -> None:
    samples = scattered_samples(mixture(2, 0), 300)
    values = np.where(np.arange(300)[:, None] % 9 == 0, -999.0, 100.0 * samples.values * samples.omega_out[:, 2:])
    rows = np.hstack([samples.omega_in * [-1.0, -1.0, 1.0], samples.omega_out, values])
    plain, odd = tmp_path / "plain.csv", tmp_path / "odd.csv"
    good = np.hstack([samples.omega_in, samples.omega_out, samples.values])[values[:, 0] > 0.0]
    for path, last, table in ((plain, "blue", good), (odd, "azure", rows)):
        np.savetxt(path, table, delimiter=",", header=",".join((*VECTORS, "red", "green", last)), comments="")
    flags = ("--columns", "blue=azure", "--missing", "-999", "--scale", "0.01", "--cosine", "out", "--phi", "mirror")
    found = [
        document("fit", path, "-o", tmp_path, "--n-lobes", "1", "--ring-lobes", "0", *words, "--json")
        for path, words in ((plain, ()), (odd, flags))
    ]
    errors = [one["report"]["metrics"]["relative_rms"] for one in found]
    assert errors[1] == pytest.approx(errors[0], rel=0.05)
    stored = load_result(tmp_path / "odd.json").report.options
    assert (stored.columns, stored.missing, stored.scale, stored.phi) == (("blue=azure",), (-999.0,), 0.01, "mirror")
    assert "samples, fit and residual" in printed("plot", tmp_path / "odd.json", odd, "-o", tmp_path / "odd.png")
    compared = document("compare", tmp_path / "odd.json", odd, "--json")
    assert compared["likeness"]["relative_rms"] == pytest.approx(
        errors[1], rel=0.05
    )  # the metric leaves grazing angles out
    assert "error of the fit " in printed("convert", odd, tmp_path / "odd.binary", *flags)
