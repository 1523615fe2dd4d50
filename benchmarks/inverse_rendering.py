"""Inverse rendering with exported Python files: a light from a picture of a measured material, and roughness.

The first table has for each material the angle between the true light and the one found by gradients from a picture of
a sphere, 64 pixels wide, of the **measurement**; the material is the fit's file. The second has the error of alpha
found from a picture, with 1 % of noise, of synthetic layers of which roughness, F0 and albedo are unknown.
"""

import argparse
import importlib.util
import tempfile
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.optimize import minimize

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf.arrays import Array
from dsbrdf.components.component import Component
from dsbrdf.components.layers import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.data.geometry import half_difference
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import export
from dsbrdf.pipeline import fit

SIZE = 64  # pixels
NOISE = 0.01  # relative, in the pictures of synthetic layers
DARK_RADIANCE = 0.01  # Relative errors of darker pixels hardly count.
N_SYNTHETIC = 20
RIM = 0.98
"""Squared radius up to which pixels count: at the very rim of the sphere a pixel has all angles."""

Slopes = tuple[float, Array]


@cache
def frames() -> Array:
    """Frames (N, 3, 3) of the sphere's pixels: two tangents and the normal, seen along -z."""
    x, y = np.meshgrid(*[(np.arange(SIZE) + 0.5) * 2.0 / SIZE - 1.0] * 2)
    inside = x * x + y * y < RIM
    normal = np.stack([x, -y, np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))], axis=-1)[inside]
    tangent = np.cross(normal, [0.31, 0.95, 0.0])
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    return np.stack([tangent, np.cross(normal, tangent), normal], axis=-2)


def module_of(source: DSBRDF | LayeredModel | Component) -> ModuleType:
    """Export a source and import its file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "material.py"
        export(source, path)
        spec = importlib.util.spec_from_file_location("material", path)
        if spec is None or spec.loader is None:
            raise ImportError(path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return module


def radiance(xp: Any, evaluate: Callable[..., Any], light: Any, parameters: dict[str, Any]) -> Any:
    """Picture (N, 3) of the sphere under a distant light, a vector as long as its irradiance."""
    strength = xp.sqrt(light @ light)
    frame = xp.asarray(frames())
    towards, view = frame @ (light / strength), frame[..., 2]
    return strength * evaluate(towards, view, parameters) * xp.clip(towards[:, 2:], 0.0, None)


def exact(source: Any, light: Array) -> Array:
    """`radiance` by the library, of a measurement's interpolation or a model."""
    strength = float(np.linalg.norm(light))
    towards, view = frames() @ (light / strength), frames()[..., 2]
    theta_half, theta_diff, phi_diff = half_difference(towards, view)
    values = source.evaluate(np.minimum(theta_half, np.pi / 2), theta_diff, phi_diff)
    return strength * values * np.clip(towards[:, 2:], 0.0, None)


class Search:
    """Finds lights and parameters; compiled once for all materials whose files have the same form."""

    def __init__(self, module: ModuleType) -> None:
        jax = self._jax = importlib.import_module("jax")
        jax.config.update("jax_enable_x64", True)

        def loss(light: Any, logarithms: dict[str, Any], fixed: dict[str, Any], picture: Any) -> Any:
            parameters = fixed | {name: jax.numpy.exp(value) for name, value in logarithms.items()}
            seen = radiance(jax.numpy, module.evaluate, light, parameters)
            return jax.numpy.mean((jax.numpy.log(seen + DARK_RADIANCE) - jax.numpy.log(picture + DARK_RADIANCE)) ** 2)

        self._loss = jax.jit(loss)
        self._by_light, self._by_parameters = (jax.jit(jax.value_and_grad(loss, argnums=place)) for place in (0, 1))

    def light(self, parameters: dict[str, Any], picture: Array) -> Array:
        """Return the light of a picture, sought from the best two of 25 directions and three strengths."""
        arrays = {name: self._jax.numpy.asarray(value) for name, value in parameters.items()}
        turns, tilts = np.arange(0.0, 2.0 * np.pi, np.pi / 4.0), np.radians([20.0, 45.0, 70.0])
        directions = [[np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)] for t in tilts for a in turns]
        starts = [s * np.array(one) for one in [*directions, [0.0, 0.0, 1.0]] for s in (0.5, 2.0, 8.0)]
        starts.sort(key=lambda start: float(self._loss(start, {}, arrays, picture)))

        def value(light: Array) -> Slopes:
            found, slope = self._by_light(light, {}, arrays, picture)
            return float(found), np.asarray(slope)

        results = [minimize(value, start, jac=True, method="BFGS") for start in starts[:2]]
        return np.asarray(min(results, key=lambda one: float(one.fun)).x)

    def parameters(
        self, fixed: dict[str, Any], start: dict[str, Any], light: Array, picture: Array
    ) -> dict[str, Array]:
        """Return the positive parameters that explain a picture, sought from `start`."""
        shapes = {name: np.shape(value) for name, value in start.items()}
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])[:-1]
        fixed = {k: self._jax.numpy.asarray(v) for k, v in fixed.items() if k not in start}

        def named(flat: Array) -> dict[str, Array]:
            return {k: part.reshape(shapes[k]) for k, part in zip(shapes, np.split(flat, ends), strict=True)}

        def value(flat: Array) -> Slopes:
            found, slope = self._by_parameters(light, named(flat), fixed, picture)
            return float(found), np.concatenate([np.ravel(slope[name]) for name in shapes])

        begin = np.concatenate([np.log(np.ravel(value)) for value in start.values()])
        return {k: np.exp(v) for k, v in named(minimize(value, begin, jac=True, method="BFGS").x).items()}


def lights(arguments: argparse.Namespace) -> list[float]:
    """Print and return the error of the light of each material [degrees]."""
    random, searches, errors = np.random.default_rng(0), dict[Any, Search](), []
    for measurement in chosen_measurements(arguments):
        module = module_of(fit(measurement).model)
        form = tuple(np.shape(value) for value in module.PARAMETERS.values())
        search = searches.setdefault(form, Search(module))
        tilt, turn = np.radians(random.uniform(15.0, 60.0)), random.uniform(0.0, 2.0 * np.pi)
        towards = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        found = search.light(module.PARAMETERS, exact(measurement.interpolated, random.uniform(1.0, 5.0) * towards))
        cosine = float(found @ towards / np.linalg.norm(found))
        errors.append(float(np.degrees(np.arccos(min(cosine, 1.0)))))
        print(f"{measurement.name:40}{errors[-1]:8.3f} degrees", flush=True)
    return errors


def roughness() -> list[float]:
    """Print and return the relative error of alpha of each synthetic material."""
    random, errors = np.random.default_rng(1), []
    light, search = np.array([1.0, 0.8, 1.5]), None
    for number in range(N_SYNTHETIC):
        alpha, f0 = float(np.exp(random.uniform(np.log(0.05), np.log(0.5)))), float(random.uniform(0.03, 0.5))
        red, green, blue = random.uniform(0.05, 0.6, 3).tolist()
        surface = SpecularLayer((f0, f0, f0), 1.0, alpha, 2.0, (0.0, 0.0), 0.5, 0.0)
        source = LayeredModel((surface, DiffuseLayer((red, green, blue), (0.0,) * 6)))
        module = module_of(source)
        search = Search(module) if search is None else search
        picture = exact(source, light)
        picture *= random.normal(1.0, NOISE, picture.shape)
        start = {"specular_1.alpha": 0.15, "specular_1.f0": [0.1] * 3, "diffuse_2.albedo": [0.2] * 3}
        found = search.parameters(module.PARAMETERS, start, light, np.maximum(picture, 0.0))
        errors.append(abs(float(found["specular_1.alpha"]) / alpha - 1.0))
        print(f"synthetic {number:2}: alpha {alpha:.4f}, found {found['specular_1.alpha']:.4f}", flush=True)
    return errors


def main(argv: Sequence[str]) -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks inverse_rendering", description=__doc__)
    add_arguments(parser, every=1, names="rgl_")
    arguments = parser.parse_args(argv)
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        angles = lights(arguments)
    print(f"largest error of a light: {max(angles):.3f} degrees, median {np.median(angles):.3f}")
    relative = roughness()
    print(f"largest error of alpha: {max(relative):.2%}, median {np.median(relative):.2%}")
    return 0
