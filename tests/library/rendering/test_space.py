"""The space of materials: distances as seen, places on the map, and midpoints."""

import numpy as np
import pytest

from dsbrdf import InvalidArgumentError, blend, space
from dsbrdf.components import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.rendering import MaterialSpace
from tests.support.known_models import single_lobe


def coated(alpha: float, color: tuple[float, float, float] = (0.4, 0.2, 0.1)) -> LayeredModel:
    surface = SpecularLayer((0.05,) * 3, 1.0, alpha, 2.0, (0.0, 0.0), 0.5, 0.0)
    return LayeredModel((surface, DiffuseLayer(color, (0.0,) * 6)))


MODELS = {f"alpha {alpha}": coated(alpha) for alpha in (0.05, 0.1, 0.2, 0.4)}


@pytest.fixture(scope="module")
def materials() -> MaterialSpace:
    matte = LayeredModel((DiffuseLayer((0.4, 0.4, 0.4), (0.0,) * 6),))
    darker = LayeredModel((DiffuseLayer((0.04, 0.01, 0.02), (0.0,) * 6),))
    return space({**MODELS, "matte": matte, "darker": darker})


def test_distances_are_those_of_roughness_not_of_colour(materials: MaterialSpace) -> None:
    np.testing.assert_allclose(materials.distance, materials.distance.T)
    assert materials.nearest("matte")[0][0] == "darker"
    polished = materials.names.index("alpha 0.05")
    assert 0.03 < materials.distance[materials.names.index("matte"), polished] < 0.3
    assert materials.nearest("matte", 1)[0][1] > 50.0  # The same but for colour and brightness, of coloured lights.
    assert [name for name, _ in materials.nearest("alpha 0.05", 2)] == ["alpha 0.1", "alpha 0.2"]
    likeness = [db for _, db in materials.nearest("alpha 0.4", 5)]
    assert likeness == sorted(likeness, reverse=True)
    index = materials.names.index
    assert likeness[0] == pytest.approx(-20 * np.log10(materials.distance[index("alpha 0.4"), index("matte")]))


def test_map_lays_out_a_series_in_its_order_with_gloss_to_the_right(materials: MaterialSpace) -> None:
    across = [materials.places[materials.names.index(name), 0] for name in (*MODELS, "matte")]
    assert across == sorted(across, reverse=True)


def test_midpoint_lies_between_its_ends() -> None:
    ends = coated(0.05, (0.05, 0.1, 0.3)), single_lobe(1.5, 1.0, 0.3)
    found = space({"a": ends[0], "middle": blend(*ends, 0.5), "b": ends[1]}).distance
    assert max(found[0, 1], found[1, 2]) < 0.8 * found[0, 2]


def test_few_materials_islands_and_bad_input() -> None:
    assert space({"one": MODELS["alpha 0.1"]}).places.tolist() == [[0.0, 0.0]]
    twins = space({"one": MODELS["alpha 0.1"], "twin": MODELS["alpha 0.1"]})
    assert twins.nearest("one") == [("twin", np.inf)]
    with pytest.raises(InvalidArgumentError, match="no material 'three'"):
        twins.nearest("three")
    with pytest.raises(InvalidArgumentError, match="at least one material"):
        space({})
    with pytest.raises(InvalidArgumentError, match="black: the material reflects no light"):
        space({"black": single_lobe(1.0, 1.0, 0.0)})
