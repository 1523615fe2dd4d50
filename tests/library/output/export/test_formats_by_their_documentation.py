"""Files of text, read again with nothing but docs/formats.md and the formulas of docs/model.md.

The readers here are written from these pages, in double precision, and take nothing from the library.
"""

import csv
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from io import StringIO
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline

import dsbrdf
from dsbrdf.components import LayeredModel
from dsbrdf.output import export_model
from tests.support.known_models import LAYERS
from tests.support.mixtures import mixture
from tests.support.random_models import papers_model

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


@dataclass(frozen=True)
class Parameters:
    """Of all lobes at one theta_diff: amplitude, kappa, gamma and center (3, K), elongation (K,), delta (3,)."""

    amplitude: Array
    kappa: Array
    gamma: Array
    center: Array
    elongation: Array
    delta: Array


def brdf(lobe: str, at: Callable[[float], Parameters]) -> Array:
    """Values (n, 3) at the angles of `GRID` by the equations of the page on the model."""
    return np.array([_value(lobe, at(diff), half, diff, phi) for half, diff, phi in zip(*GRID, strict=True)])


def _value(lobe: str, found: Parameters, theta_half: float, theta_diff: float, phi_diff: float) -> Array:
    cos4 = np.cos(theta_diff) ** 4
    g = (cos4 + 0.08**4 * (1.0 - cos4)) ** 0.25
    stretch = g**-found.elongation * np.cos(phi_diff) ** 2 + g**found.elongation * np.sin(phi_diff) ** 2
    tangent = np.tan(theta_half) * np.sqrt(stretch)

    def s(tangent: Array) -> Array:
        center, kappa, gamma = found.center, found.kappa, found.gamma
        distance = np.where(center < 0.0, np.arctan(tangent + np.tan(-center)), np.arctan(tangent) - center)
        if lobe == "student":
            return np.asarray((1.0 + gamma * np.tan(distance) ** 2) ** -kappa)
        return np.asarray(np.expm1(kappa * np.cos(distance) ** gamma) / np.expm1(kappa))

    height = np.where(found.center < 0.0, s(np.zeros(1)), 1.0)
    delta = found.delta if theta_half < np.radians(1.0) else 0.0
    return np.asarray((found.amplitude * s(tangent) / height).sum(axis=1) + delta)


def assert_is(found: Array, source: dsbrdf.DSBRDF | LayeredModel) -> None:
    """Values agree to 1e-6 of the largest at their theta_diff."""
    expected = source.evaluate_unmasked(*GRID)
    peak = np.array([expected[GRID[1] == diff].max(axis=0) for diff in GRID[1]])
    assert np.abs((found - expected) / peak).max() < 1e-6


@pytest.mark.parametrize("kind", MODELS)
def test_json(kind: str) -> None:
    content = json.loads(export_model(MODELS[kind], "json"))["model"]
    array = {name: np.array(value) for name, value in content.items()}
    is_spline = content["interpolation"] == "spline"

    def along(knots: str, values: Array, axis: int, theta_diff: float) -> Array:
        values, k = np.moveaxis(values, axis, 0), array[knots].tolist()
        held = min(max(theta_diff, k[0]), k[-1])
        if len(k) == 1:
            return np.asarray(values[0])
        if is_spline:
            return np.asarray(BSpline([k[0]] * 3 + k + [k[-1]] * 3, values, 3)(held))
        rows = values.reshape(len(k), -1).T
        return np.array([np.interp(held, k, row) for row in rows]).reshape(values.shape[1:])

    def at(theta_diff: float) -> Parameters:
        to, back = (np.log, np.exp) if is_spline else (np.asarray, np.asarray)
        height, level = (np.log, np.exp) if is_spline else (np.log1p, np.expm1)
        shapes = {name: to(array[name]) for name in ("kappa", "gamma")} | {"center": array["center"]}
        found = {name: along("shape_theta_diff", one, 1, theta_diff) for name, one in shapes.items()}
        delta = [np.interp(theta_diff, array["theta_diff"], row) for row in array["delta"]]
        return Parameters(
            level(along("theta_diff", height(array["amplitude"]), 1, theta_diff)),
            back(found["kappa"]),
            back(found["gamma"]),
            found["center"],
            along("elongation_theta_diff", array["elongation"], 0, theta_diff),
            np.array(delta),
        )

    assert_is(brdf(content["lobe"], at), MODELS[kind])


@pytest.mark.parametrize("kind", MODELS)
def test_csv(kind: str) -> None:
    model = replace(MODELS[kind], delta=np.zeros_like(MODELS[kind].delta))  # the table has no delta term
    rows = list(csv.DictReader(StringIO(export_model(model, "csv").decode())))
    table = {(round(float(row["theta_diff_deg"])), row["channel"], int(row["lobe"])): row for row in rows}
    lobes = range(1 + max(int(row["lobe"]) for row in rows))

    def at(theta_diff: float) -> Parameters:
        place = round(np.degrees(theta_diff))

        def column(name: str) -> Array:
            channels = ("red", "green", "blue")
            return np.array([[float(table[place, channel, one][name]) for one in lobes] for channel in channels])

        shapes = column("amplitude"), column("kappa"), column("gamma"), np.radians(column("center_deg"))
        return Parameters(*shapes, column("elongation")[0], np.zeros(3))

    assert_is(brdf(model.lobe, at), model)


def glass(cosine: Array) -> Array:
    """How far the reflectance of glass has risen, by Fresnel's equations."""
    refracted = np.sqrt(1.0 - (1.0 - cosine**2) / 1.5**2)
    across = (cosine - 1.5 * refracted) / (cosine + 1.5 * refracted)
    along = (1.5 * cosine - refracted) / (1.5 * cosine + refracted)
    return np.asarray(((across**2 + along**2) / 2.0 - 0.04) / 0.96)


def layer_values(layer: dict[str, Any]) -> Array:
    """Values (3, n) of one layer at the angles of `GRID`."""
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
        q_1, q_2 = layer["rise"]
        shape = facets(np.minimum(np.tan(half) ** 2, 1e4), layer["alpha"], layer["tail_exponent"], layer["masking"])
        shape = shape * np.exp(q_1 * u + q_2 * u**2) * (0.96**2 * (1.0 - s_i) * (1.0 - s_o)) ** layer["under_coat"]
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
