"""The table of parameters holds those of the model."""

import csv
from io import StringIO

import numpy as np
import pytest

from dsbrdf.data.grid import CHANNELS
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import export_model
from tests.support.mixtures import mixture
from tests.support.random_models import papers_model


@pytest.mark.parametrize("model", [mixture(3, 0), papers_model()], ids=["mixture", "paper"])
def test_rows_are_the_parameters(model: DSBRDF) -> None:
    rows = list(csv.DictReader(StringIO(export_model(model, "csv").decode())))
    assert len(rows) == model.n_lobes * 3 * 19
    for row in rows[::7]:
        lobe, channel = int(row["lobe"]), CHANNELS.index(row["channel"])
        found = model.parameters_at([np.radians(float(row["theta_diff_deg"]))])
        assert float(row["amplitude"]) == pytest.approx(found["amplitude"][0, channel, lobe], rel=1e-7)
        shape = channel if found["kappa"].shape[1] == 3 else 0
        for name in ("kappa", "gamma"):
            assert float(row[name]) == pytest.approx(found[name][0, shape, lobe], rel=1e-7)
        assert float(row["elongation"]) == pytest.approx(found["elongation"][0, lobe], abs=1e-7)
