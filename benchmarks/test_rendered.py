"""What the rendered spheres are compared with is what it says."""

import numpy as np

from benchmarks.paper.ggx import GGXModel
from benchmarks.rendered import phi_means
from dsbrdf import Measurement
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF, nodes_above_horizon


def test_ggx_lobes_have_the_same_values_at_points_as_on_the_grid() -> None:
    normal, grazing = np.array([[[0.2, 0.1], [0.3, 0.0], [0.1, 0.4]], [[0.8, 0.3], [0.7, 0.2], [0.9, 0.6]]])
    model = GGXModel(np.array([0.3, 0.2, 0.1]), np.array([0.1, 0.4]), normal, grazing)
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
