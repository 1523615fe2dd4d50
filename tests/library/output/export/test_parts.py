"""What formats take of a model: all of it, a component, or the guide."""

import numpy as np
import pytest

from dsbrdf.data.merl import parse_merl
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.decomposition import LABELS, decompose
from dsbrdf.output.export import GUIDE, PARTS, export_model, part_of
from dsbrdf.output.serialize import from_json
from tests.support.mixtures import mixture

MODEL = mixture(2, 0)
QUICK = ("json", "npz", "glsl", "brdf", "csv")


def test_tables_of_components_add_up_to_that_of_the_model() -> None:
    tables = [parse_merl(export_model(part, "merl")).values for part in (MODEL, *decompose(MODEL))]
    whole, *parts = (np.nan_to_num(table) for table in tables)
    assert len(parts) == 2
    assert all(part.max() > 0.01 for part in parts)
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-9)


@pytest.mark.parametrize("file_format", ["json", "npz", "csv", "materialx"])
def test_a_format_of_lobes_refuses_a_component(file_format: str) -> None:
    said = rf"^{file_format} cannot hold a component.* merl, glsl, brdf, bsdf or bsdf-spectral, or export the guide"
    with pytest.raises(InvalidArgumentError, match=said):
        export_model(decompose(MODEL)["diffuse"], file_format)


def test_the_guide_is_stored_as_a_model() -> None:
    guide, report = from_json(export_model(part_of(MODEL, GUIDE), "json").decode())
    assert report is None
    assert guide == decompose(MODEL).guide
    at = np.radians([0.0, 5.0, 40.0]), np.radians([0.0, 30.0, 30.0])
    np.testing.assert_allclose(guide.evaluate(*at), sum(part.lobe.evaluate(*at) for part in decompose(MODEL)))


@pytest.mark.parametrize("file_format", QUICK)
def test_a_format_takes_the_guide(file_format: str) -> None:
    assert export_model(part_of(MODEL, GUIDE), file_format) != export_model(MODEL, file_format)


def test_parts_are_those_of_the_decomposition() -> None:
    assert PARTS == (*LABELS, "guide")
    assert part_of(MODEL, None) is MODEL
    assert part_of(MODEL, "diffuse") is decompose(MODEL).diffuse
    (absent,) = set(LABELS) - set(decompose(MODEL).labels)
    with pytest.raises(InvalidArgumentError, match=f"this model has no component {absent}: it has"):
        part_of(MODEL, absent)
