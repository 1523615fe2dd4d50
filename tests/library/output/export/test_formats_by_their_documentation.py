"""Files of text, read again with nothing but docs/formats.md and the formulas of docs/model.md.

The readers here are written from these pages, in double precision.
"""

import csv
import json
import re
from collections import defaultdict
from dataclasses import replace
from io import StringIO
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

import dsbrdf
from dsbrdf.components import LayeredModel
from dsbrdf.data import CHANNELS
from dsbrdf.output import export_model
from tests.support.models import LAYERS, mixture, papers_model

Array = NDArray[np.float64]

THETA_HALF = np.radians([0.0, 0.5, 1.5, 5.0, 20.0, 45.0, 80.0])
PHI_DIFF = np.radians([0.0, 40.0, 90.0])
THETA_DIFF = np.radians([0.0, 10.0, 25.0, 60.0, 80.0])  # some of those that the table has
GRID = tuple(part.ravel() for part in np.meshgrid(THETA_HALF, THETA_DIFF, PHI_DIFF, indexing="ij"))


def with_rings(lobe: Literal["hemi_epd", "student"]) -> dsbrdf.DSBRDF:
    about_the_normal = mixture(3, 0)
    center = np.broadcast_to(np.radians([0.0, 12.0, -10.0]), about_the_normal.kappa.shape)
    return replace(about_the_normal, lobe=lobe, center=center)


MODELS = {"hemi_epd": with_rings("hemi_epd"), "student": with_rings("student"), "paper": papers_model()}


def lobe_value(lobe: str, row: dict[str, float], theta_half: float, theta_diff: float, phi_diff: float) -> float:
    """Value of one lobe by the equations of the page on the model."""
    cos4 = np.cos(theta_diff) ** 4
    stretch = (cos4 + 0.08**4 * (1.0 - cos4)) ** (0.25 * row["elongation"])
    squared = np.cos(phi_diff) ** 2 / stretch + np.sin(phi_diff) ** 2 * stretch
    center = np.radians(row["center_deg"])

    def s(tangent: float) -> float:
        distance = np.arctan(tangent + np.tan(-center)) if center < 0.0 else np.arctan(tangent) - center
        if lobe == "student":
            return float((1.0 + row["gamma"] * np.tan(distance) ** 2) ** -row["kappa"])
        return float(np.expm1(row["kappa"] * np.cos(distance) ** row["gamma"]) / np.expm1(row["kappa"]))

    return row["amplitude"] * s(np.tan(theta_half) * np.sqrt(squared)) / (s(0.0) if center < 0.0 else 1.0)


def assert_is(found: Array, source: dsbrdf.DSBRDF | LayeredModel) -> None:
    expected = source.evaluate_unmasked(*GRID)
    peak = np.array([expected[GRID[1] == diff].max(axis=0) for diff in GRID[1]])
    assert np.abs((found - expected) / peak).max() < 1e-6


@pytest.mark.parametrize("kind", MODELS)
def test_csv(kind: str) -> None:
    model = replace(MODELS[kind], delta=np.zeros_like(MODELS[kind].delta))  # the table has no delta term
    table = defaultdict[tuple[int, str], list[dict[str, float]]](list)
    for row in csv.DictReader(StringIO(export_model(model, "csv").decode())):
        place = round(float(row["theta_diff_deg"])), row.pop("channel")
        table[place].append({name: float(value) for name, value in row.items()})
    found = [
        [sum(lobe_value(model.lobe, row, *at) for row in table[round(np.degrees(at[1])), name]) for name in CHANNELS]
        for at in zip(*GRID, strict=True)
    ]
    assert_is(np.array(found), model)


def glass(cosine: Array) -> Array:
    """How far the reflectance of glass has risen, by Fresnel's equations."""
    refracted = np.sqrt(1.0 - (1.0 - cosine**2) / 1.5**2)
    across = (cosine - 1.5 * refracted) / (cosine + 1.5 * refracted)
    along = (1.5 * cosine - refracted) / (1.5 * cosine + refracted)
    return np.asarray(((across**2 + along**2) / 2.0 - 0.04) / 0.96)


def layer_values(layer: dict[str, Any]) -> Array:
    half, diff, phi = GRID
    level, swing = np.cos(half) * np.cos(diff), np.sin(half) * np.sin(diff) * np.cos(phi)
    c_i, c_o = np.maximum(level - swing, 0.02), np.maximum(level + swing, 0.02)
    u, s, s_i, s_o = 1.0 - np.cos(diff), glass(np.cos(diff)), glass(c_i), glass(c_o)

    def facets(tangent2: Array, alpha: float, kappa: float, b: float) -> Array:
        g = (1.0 + np.log1p(np.exp(8.0 * kappa - 9.0))) / 8.0
        d = (1.0 + tangent2) ** 2 / (np.pi * alpha**2) * (1.0 + tangent2 / (g * alpha**2)) ** -kappa
        v_i, v_o = (np.sqrt(alpha**2 + (1.0 - alpha**2) * c**2) for c in (c_i, c_o))
        return np.asarray(d * (2.0 * (c_o * v_i + c_i * v_o)) ** (b - 1.0) * ((c_i + v_i) * (c_o + v_o)) ** -b)

    if "f0" in layer:
        (q_1, q_2), m = layer["rise"], layer["schlick"]
        s = (1.0 - m) * s + m * u**5
        r, b_i, b_o = layer["refraction"], np.sqrt(1.25 + c_i**2), np.sqrt(1.25 + c_o**2)
        tangent2 = np.minimum(np.tan(half) ** 2, 1e4) * ((c_i + c_o) / (b_i + b_o)) ** (2.0 * r)
        shape = facets(tangent2, layer["alpha"] / 1.5**r, layer["tail_exponent"], layer["masking"])
        shape = shape * np.exp(q_1 * u + q_2 * u**2) * (0.96**2 * (1.0 - s_i) * (1.0 - s_o)) ** layer["under_coat"]
        shape = shape * (c_i * c_o / (b_i * b_o)) ** r
        return np.outer(layer["f0"], shape * (1.0 - s)) + layer["f90"] * s * shape
    if "albedo" in layer:
        a = np.cos(2.0 * diff) - c_i * c_o
        a = np.where(a > 0.0, a / np.maximum(c_i, c_o), a)
        passed, limb = np.log((1.0 - s_i) * (1.0 - s_o)), np.log(2.0 / (c_i + c_o))
        x = np.array([passed, np.cos(diff) ** 2 * (s_i + s_o), s, limb, np.sin(half) ** 2, a])
        return np.outer(layer["albedo"], np.exp(np.array(layer["exponents"]) @ x) / np.pi)
    if "powers" in layer:
        a, b = layer["powers"]
        return np.outer(layer["color"], np.maximum(u, 0.001) ** a * np.maximum(np.sin(half), 0.03) ** b)
    tangent2 = (4.0 * np.sin(diff) ** 2 - (c_i - c_o) ** 2) / (c_i + c_o) ** 2
    return np.outer(layer["color"], facets(tangent2, layer["alpha"], 2.0, 0.0))


def test_layers_as_json() -> None:
    document = json.loads(export_model(LAYERS, "json"))
    assert document["format"] == "dsbrdf-layers"
    assert_is(np.sum([layer_values(layer) for layer in document["layers"]], axis=0).T, LAYERS)


def test_layers_as_csv() -> None:
    layers: dict[str, dict[str, Any]] = {}
    for row in csv.DictReader(StringIO(export_model(LAYERS, "csv").decode())):
        name = re.sub("_(red|green|blue|[0-9])$", "", row["parameter"])
        kept = layers.setdefault(row["layer"], {})
        value = float(row["value"])
        kept[name] = value if name == row["parameter"] else [*kept.get(name, []), value]
    assert_is(np.sum([layer_values(layer) for layer in layers.values()], axis=0).T, LAYERS)
