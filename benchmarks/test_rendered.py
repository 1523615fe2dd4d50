"""What the rendered spheres are compared with is what it says."""

import numpy as np

from benchmarks.rendered import phi_means
from dsbrdf import Measurement


def test_the_table_of_means_holds_the_mean_of_every_valid_node(plastic: Measurement) -> None:
    table = phi_means(plastic)
    assert (table.valid == plastic.valid).all()
    for row, diff in ((0, 0), (20, 40), (60, 50), (70, 30)):
        valid = plastic.valid[row, diff]
        expected = plastic.values[:, row, diff, valid].mean(axis=1, keepdims=True)
        np.testing.assert_allclose(table.values[:, row, diff, valid], expected * np.ones(valid.sum()), rtol=1e-12)
