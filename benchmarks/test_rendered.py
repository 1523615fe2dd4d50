"""What the rendered spheres are compared with is what it says."""

import numpy as np

from benchmarks.paper.ggx import fit_ggx
from benchmarks.rendered import phi_means
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF, nodes_above_horizon
from dsbrdf.data.measurement import Measurement


def test_ggx_lobes_have_the_same_values_at_points_as_on_the_grid(plastic: Measurement) -> None:
    model = fit_ggx(plastic, 1, "log", DEFAULT_HORIZON_CUTOFF)
    for i in (0, 30, 70):
        row, column = np.nonzero(nodes_above_horizon()[i])
        points = model.evaluate(np.full(row.shape, THETA_HALF[i]), THETA_DIFF[row], PHI_DIFF[column])
        np.testing.assert_allclose(points.T, model.row(i)[:, row, column], rtol=1e-6)


def test_the_table_of_means_holds_the_mean_of_every_valid_node(plastic: Measurement) -> None:
    table = phi_means(plastic)
    assert (table.valid == plastic.valid).all()
    for row, diff in ((0, 0), (20, 40), (60, 50), (70, 30)):
        valid = plastic.valid[row, diff]
        expected = plastic.values[:, row, diff, valid].mean(axis=1, keepdims=True)
        np.testing.assert_allclose(table.values[:, row, diff, valid], expected * np.ones(valid.sum()), rtol=1e-12)
