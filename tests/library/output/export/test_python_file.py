"""Exported Python files: NumPy, JAX and, where it is installed, PyTorch against the library; derivatives too."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dsbrdf.arrays import Array
from dsbrdf.components.component import Component
from dsbrdf.components.decomposition import decompose
from dsbrdf.components.layers import DiffuseLayer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer
from dsbrdf.data.geometry import half_difference
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import export_model
from tests.support import array_libraries, known_models
from tests.support.array_libraries import WITHOUT_DERIVATIVES, loaded
from tests.support.mixtures import mixture
from tests.support.random_models import random_model

Source = DSBRDF | LayeredModel | Component

LIBRARIES = [name for name in ("jax", "torch") if importlib.util.find_spec(name) is not None]
MAX_LINES = 150
GROUND = DiffuseLayer((0.4, 0.2, 0.05), (0.7, 0.1, -0.2, 0.3, 0.5, -0.6))
COAT = SpecularLayer((0.04, 0.041, 0.042), 0.9, 0.05, 2.0, (0.2, -0.3), 0.4, 0.0)
METAL = SpecularLayer((0.9, 0.6, 0.3), 1.1, 0.3, 5.0, (-0.1, 0.2), 0.8, 1.0)
CLOTH = LayeredModel((RetroLayer((0.1, 0.2, 0.3), 0.1), GROUND, SheenLayer((0.02, 0.03, 0.1), (2.0, 3.0)), METAL))
WHOLE: dict[str, Source] = {
    **known_models.MODELS,
    "one knot": known_models.single_lobe(2.0, 900.0, 0.5, family="student"),
    "long stretch": known_models.single_lobe(1.5, 40.0, 0.5, center=0.2, elongation=6.0),
    "coat over metal": LayeredModel((COAT, METAL)),
    "cloth": CLOTH,
    "no layers": LayeredModel(()),
    "no lobes": random_model(0, n_lobes=0),
}
DECOMPOSED = {
    "three components": mixture(3, 0),
    "rings": known_models.MODELS["elongated rings and cusps"],
    "diffuse alone": known_models.single_lobe(1.5, 1.0, 0.5),
    "paper": known_models.MODELS["paper"],
}
TWO_KNOT_MODEL = DSBRDF(  # JAX compiles every knot
    np.radians([0.0, 80.0]),
    amplitude=np.random.default_rng(0).uniform(0.1, 3.0, (3, 4, 3)),
    kappa=np.array([[[0.5, 1.0, 2.0]] * 4]),
    gamma=np.array([[[300.0, 40.0, 2.0]] * 4]),
    center=np.array([[[0.0, 0.2, -0.1]] * 4]),
    elongation=np.array([[0.5, -0.3, 0.2]]),
)
PAIRS = known_models.pairs_of_directions(2000, lowest=float(np.cos(np.radians(80.0))), spread=0.03)
"""Pairs in single precision; not quite of length 1, they are no nodes of anything."""


def written(source: Source, path: Path) -> Path:
    content = export_model(source, "python")
    assert len(content.decode().splitlines()) <= MAX_LINES
    path.write_bytes(content)
    return path


def expected_of(source: Source, first: Array, second: Array) -> tuple[Array, Array]:
    """The library's values, and those of the whole material, of which a component is a difference."""
    angles = half_difference(first, second)  # The library's own way would make them unit vectors.
    whole = source.whole.model if isinstance(source, Component) else source
    return source.evaluate(*angles), whole.evaluate(*angles)


def check(source: Source, path: Path) -> None:
    evaluate = loaded(written(source, path)).evaluate
    unit = [one / np.linalg.norm(one, axis=1)[:, None] for one in PAIRS]
    expected, whole = expected_of(source, *unit)
    assert np.all(np.abs(evaluate(*unit) - expected) <= 1e-12 * np.maximum(whole, 1e-12))
    expected, whole = expected_of(source, *PAIRS)
    values = evaluate(*(one.astype(np.float32) for one in PAIRS))
    assert values.dtype == np.float32
    assert np.all(np.abs(values - expected) <= 1e-5 * np.maximum(whole, 1e-3) + jumps(source, *PAIRS))


def jumps(source: Source, first: Array, second: Array) -> Array | float:
    """What rounding theta_diff and knots changes in the paper's model, whose parameters at each knot are random."""
    model = source.whole.model if isinstance(source, Component) else source
    if not isinstance(model, DSBRDF) or model.interpolation == "spline":
        return 0.0
    theta_half, theta_diff, phi_diff = half_difference(first, second)
    rounding = 4.0 * float(np.finfo(np.float32).eps)
    return np.abs(
        source.evaluate(theta_half, theta_diff + rounding, phi_diff)
        - source.evaluate(theta_half, theta_diff - rounding, phi_diff)
    )


@pytest.mark.parametrize("name", WHOLE)
def test_values_of_models_and_layers(name: str, tmp_path: Path) -> None:
    check(WHOLE[name], tmp_path / "material.py")


@pytest.mark.parametrize("name", DECOMPOSED)
def test_values_of_components_and_their_weighted_sum(name: str, tmp_path: Path) -> None:
    parts = decompose(DECOMPOSED[name])
    for part in parts:
        check(part, tmp_path / f"{part.label}.py")
    if len(parts) > 1:
        whole = loaded(tmp_path / f"{part.label}.py").evaluate(*PAIRS, shown=(1.0, 1.0, 1.0))
        np.testing.assert_allclose(whole, DECOMPOSED[name].evaluate(*half_difference(*PAIRS)), rtol=1e-10, atol=1e-24)


def test_one_pair_lists_whole_numbers_and_directions_below_the_horizon(tmp_path: Path) -> None:
    evaluate = loaded(written(CLOTH, tmp_path / "cloth.py")).evaluate
    assert evaluate([0, 0, 1], [0, 0, 1]).shape == (3,)
    np.testing.assert_allclose(evaluate([0, 0, 1], [0, 0, 1]), CLOTH.evaluate(0.0, 0.0))
    grid = evaluate(PAIRS[0][:4, None], PAIRS[1][None, :5])
    np.testing.assert_allclose(grid, CLOTH.evaluate_directions(PAIRS[0][:4, None], PAIRS[1][None, :5]), rtol=1e-5)
    assert not evaluate([[0.6, 0.0, -0.8], [0.0, 0.0, 1.0]], [0.0, 0.6, 0.8])[0].any()


def test_a_file_needs_nothing_of_this_library(tmp_path: Path) -> None:
    path = written(decompose(DECOMPOSED["three components"])["diffuse"], tmp_path / "diffuse.py")
    code = (
        f"import sys; sys.modules['dsbrdf'] = None; exec(open({str(path)!r}).read()); print(evaluate([0,0,1], [0,0,1]))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("library", LIBRARIES)
def test_values_and_derivatives_in_other_libraries(library: str, tmp_path: Path) -> None:
    sources: dict[str, Source] = {
        "model": TWO_KNOT_MODEL,
        "layers": CLOTH,
        f"{WITHOUT_DERIVATIVES}_component": decompose(DECOMPOSED["three components"])["specular_lobe"],
    }
    modules = {name: loaded(written(source, tmp_path / f"{name}.py")) for name, source in sources.items()}
    random, first, second = np.random.default_rng(0), *(one[:200] for one in PAIRS)
    # Where a derivative might fail: the mirror direction, light from the viewer and from the normal, the horizon.
    first[:5] = np.array([[0.6, 0.0, 0.8], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, -0.8]])
    second[:4] = np.array([[-0.6, 0.0, 0.8], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [-0.6, 0.0, 0.8]])
    weight = random.uniform(0.5, 1.0, (*first.shape[:1], 3))
    np.savez(tmp_path / "pairs.npz", omega_in=first, omega_out=second, weight=weight)
    subprocess.run([sys.executable, "-W", "error", array_libraries.__file__, library, tmp_path], check=True)

    for name, module in modules.items():
        with np.load(tmp_path / f"{name}.npz") as stored:
            found = dict(stored)
        if name.startswith(WITHOUT_DERIVATIVES):
            expected, whole = expected_of(sources[name], first[5:], second[5:])
            assert found["single"].dtype == np.float32
            assert np.all(np.abs(found["single"][5:] - expected) <= 1e-5 * np.maximum(whole, 1e-3))
            continue
        np.testing.assert_allclose(found.pop("values"), module.evaluate(first, second), rtol=1e-12)
        assert all(np.isfinite(slope).all() for slope in found.values())
        regular, arrays = slice(5, None), {k: np.asarray(v) for k, v in module.PARAMETERS.items()}
        for changed in (*arrays, "omega_in", "omega_out"):
            of = {"omega_in": first, "omega_out": second}.get(changed, arrays.get(changed))
            assert of is not None
            step = 1e-6 * random.normal(size=of.shape) * (np.abs(of) + 1e-3)
            if changed.startswith("omega"):
                step[:5] = 0.0
            values = []
            for sign in (1.0, -1.0):
                now = arrays | {"omega_in": first, "omega_out": second} | {changed: of + sign * step}
                values.append(module.evaluate(now.pop("omega_in"), now.pop("omega_out"), now))
            steps = (weight * (values[0] - values[1]) / 2.0)[regular if changed.startswith("omega") else slice(None)]
            assert np.sum(found[f"by {changed}"] * step) == pytest.approx(steps.sum(), rel=1e-5, abs=1e-12), changed
