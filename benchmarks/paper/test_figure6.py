"""The space of materials: against classical scaling, and neighbours by brute force."""

import csv
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper import figure6
from benchmarks.paper.materials import Computed, Material
from benchmarks.paper.paper_figure import PaperFigure, make
from dsbrdf import FitResult, InvalidArgumentError

needs_scikit_learn = pytest.mark.skipif(find_spec("sklearn") is None, reason='"scikit-learn" is not installed')


@pytest.fixture
def computed() -> list[Computed]:
    """Six materials with random parameters."""
    rng = np.random.default_rng(3)
    return [
        Computed(
            f"material_{index}",
            True,
            {
                "parameters": rng.normal(size=(3, 18, 3, 2)),
                "sphere": np.zeros((figure6._SIZE, figure6._SIZE, 3), np.uint8),
                "gloss": np.array(float(index)),
            },
        )
        for index in range(6)
    ]


def distances(computed: list[Computed]) -> np.ndarray:
    """Distances between the standardized parameters at theta_diff = 0, pair by pair."""
    rows = np.array([one["parameters"][:, 0].ravel() for one in computed])
    rows = rows / rows.std(axis=0)
    return np.array([[np.sqrt(np.sum((a - b) ** 2)) for b in rows] for a in rows])


@needs_scikit_learn
def test_embedding_of_few_materials_is_classical_scaling(computed: list[Computed]) -> None:
    # Each is a neighbour of all others: the geodesics are straight lines.
    squared = distances(computed) ** 2
    centre = np.eye(6) - 1.0 / 6.0
    values, vectors = np.linalg.eigh(-0.5 * centre @ squared @ centre)
    expected = vectors[:, :-3:-1] * np.sqrt(values[:-3:-1])
    found = figure6.embedding(computed, "theta_diff_0")
    np.testing.assert_allclose(np.abs(found), np.abs(expected), rtol=1e-6, atol=1e-8)
    assert found[:, 0] @ np.arange(6.0) > 0.0


def test_nearest_materials(computed: list[Computed]) -> None:
    found = figure6.nearest(computed, "theta_diff_0")
    for own, line in enumerate(distances(computed)):
        others = sorted((distance, other) for other, distance in enumerate(line) if other != own)
        assert found[own] == [other for _, other in others[:3]]


def test_few_materials_have_no_space(tmp_path: Path) -> None:
    assert figure6.FIGURE.at_least == 4
    with pytest.raises(InvalidArgumentError, match="figure6 needs at least 4 materials, not 0"):
        make(figure6.FIGURE, [], tmp_path)


def test_parameters_are_those_of_the_fit_with_three_lobes(
    material: Material, quick_fits: dict[str, FitResult], small_spheres: int
) -> None:
    numbers = figure6.FIGURE.measure(material)
    model = quick_fits["paper-3"].model
    np.testing.assert_allclose(numbers["parameters"][..., 0], np.log(model.kappa.clip(1e-3, 20.0)))
    np.testing.assert_allclose(numbers["parameters"][..., 1], np.log(model.gamma.clip(1e-2, 1e5)))
    peak, aside = quick_fits["global-auto"].model.evaluate(np.radians([0.0, 45.0]), 0.0).mean(axis=1)
    assert float(numbers["gloss"]) == pytest.approx(np.log10(peak / aside))


@needs_scikit_learn
def test_figure_is_written(computed: list[Computed], tmp_path: Path) -> None:
    by_name = {one.name: one for one in computed}
    figure = PaperFigure(**{**vars(figure6.FIGURE), "measure": lambda material: dict(by_name[material.name].numbers)})
    for name in by_name:
        (tmp_path / f"{name}.binary").touch()
    made = make(figure, [Material(tmp_path / f"{name}.binary", tmp_path) for name in by_name], tmp_path)
    with (tmp_path / "figure6.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    places = np.array([[float(line["x_all_slices"]), float(line["y_all_slices"])] for line in lines])
    np.testing.assert_allclose(places, figure6.embedding(computed, "all_slices"))
    near = figure6.nearest(computed, "theta_diff_0")[0]
    assert lines[0]["nearest_theta_diff_0"].split() == [f"material_{other}" for other in near]
    assert len(figure.claims(made.computed)) == 3
    assert figure6.features(computed, "theta_diff_0").shape == (6, 18)
    assert figure6.features(computed, "all_slices").shape == (6, 324)
