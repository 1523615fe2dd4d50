"""Tables of a known truth, from the upload to a value of the fit: right, or what is wrong is told."""

import numpy as np
import pytest

from dsbrdf.data.table_options import TableOptions
from dsbrdf_service.wire.fit_options import table_query
from tests.library.data.test_layouts import MIRROR_60, TRUTHS
from tests.support.server import Server

pytestmark = pytest.mark.slow

NAMES = (
    "mirror at the same phi",
    "in plane, sign turned",
    "0 is missing",
    "9999 is missing",
    "flat spectra",
    "per cent reflectance factor",
)
NOT_SAID = tuple(f"{name}, not said" for name in NAMES if f"{name}, not said" in TRUTHS)


@pytest.mark.parametrize("name", [*NAMES, *NOT_SAID])
def test_a_table_is_fitted_to_its_truth_or_told(server: Server, name: str) -> None:
    content, choices, words = TRUTHS[name]
    options = table_query(TableOptions(**choices)) | {"n_lobes": "2", "ring_lobes": "0"}
    headers = {"Content-Type": "text/csv", "Prefer": "wait=60"}
    fit = server.http.post("/v1/fits", params=options, content=content, headers=headers).json()
    if words:
        assert any(words in sentence for sentence in fit["warnings"]), fit
        return
    angles = {"theta_in_deg": 60, "theta_out_deg": 60}
    value = server.http.get(f"/v1/fits/{fit['id']}/brdf", params=angles).json()["values"]
    np.testing.assert_allclose(np.ravel(value), [MIRROR_60] * 3, rtol=0.1)
