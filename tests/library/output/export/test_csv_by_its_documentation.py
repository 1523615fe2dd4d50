"""The table of parameters, read again with nothing but the formulas of docs/model.md."""

import csv
from dataclasses import replace
from io import StringIO
from typing import Literal

import numpy as np
import pytest

from dsbrdf.arrays import Array
from dsbrdf.data.grid import CHANNELS
from dsbrdf.output.export import export_model
from tests.support.mixtures import mixture

THETA_HALF = np.radians([0.0, 1.0, 5.0, 20.0, 45.0, 80.0])
PHI_DIFF = np.radians([0.0, 40.0, 90.0])


def lobe_by_its_formula(lobe: str, theta_diff: float, row: dict[str, str]) -> Array:
    """Return the amplitude times s(theta'; kappa, gamma, c), of shape ``(theta_half, phi_diff)``."""
    names = ("amplitude", "kappa", "gamma", "center_deg", "elongation")
    amplitude, kappa, gamma, center, elongation = (float(row[name]) for name in names)
    center = np.radians(center)
    cos4 = np.cos(theta_diff) ** 4
    g = (cos4 + 0.08**4 * (1.0 - cos4)) ** 0.25
    stretch = g**-elongation * np.cos(PHI_DIFF) ** 2 + g**elongation * np.sin(PHI_DIFF) ** 2
    tangent = np.tan(THETA_HALF)[:, None] * np.sqrt(stretch)

    def s(tangent: Array) -> Array:
        distance = np.arctan(tangent + np.tan(-center)) if center < 0.0 else np.arctan(tangent) - center
        if lobe == "student":
            return np.asarray((1.0 + gamma * np.tan(distance) ** 2) ** -kappa)
        return np.asarray((np.exp(kappa * np.cos(distance) ** gamma) - 1.0) / (np.exp(kappa) - 1.0))

    return amplitude * s(tangent) / (s(np.zeros(())) if center < 0.0 else 1.0)


@pytest.mark.parametrize("lobe", ["hemi_epd", "student"])
def test_the_table_and_the_formulas_are_the_model(lobe: Literal["hemi_epd", "student"]) -> None:
    about_the_normal = mixture(3, 0)
    center = np.broadcast_to(np.radians([0.0, 12.0, -10.0]), about_the_normal.kappa.shape)
    model = replace(about_the_normal, lobe=lobe, center=center)
    rows = list(csv.DictReader(StringIO(export_model(model, "csv").decode())))
    for degrees in (0.0, 30.0, 60.0, 80.0):
        found = np.zeros((THETA_HALF.size, PHI_DIFF.size, 3))
        for row in rows:
            if float(row["theta_diff_deg"]) == degrees:
                found[..., CHANNELS.index(row["channel"])] += lobe_by_its_formula(lobe, np.radians(degrees), row)
        points = np.broadcast_arrays(THETA_HALF[:, None], np.radians(degrees), PHI_DIFF)
        expected = model.evaluate_unmasked(*(angle.ravel() for angle in points))
        np.testing.assert_allclose(found.reshape(-1, 3), expected, rtol=1e-6)
