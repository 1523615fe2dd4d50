"""RGL files as Mitsuba evaluates them, on the grid, and files that are none."""

import importlib
import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.rgl_material import parse_rgl, read_rgl
from dsbrdf.data.tensor_file import encode_tensors, parse_tensors
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.output.export.rgl import rgl_bsdf
from tests.support.mixtures import mixture

Array = NDArray[np.float64]

MODEL = mixture(2, 1)


@pytest.fixture(scope="module")
def mitsuba() -> ModuleType:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip('"mitsuba" is not installed')
    module = importlib.import_module("mitsuba")
    module.set_variant("scalar_rgb")
    return module


def random_fields() -> dict[str, NDArray[Any]]:
    """A file whose tables have nothing to do with each other: 5 angles, no two shapes alike."""
    random = np.random.default_rng(0)
    angles = np.radians([0.0, 20.0, 45.0, 70.0, 88.0])
    tables = {
        "ndf": random.uniform(0.5, 2.0, (3, 40)),
        "sigma": np.tile(random.uniform(0.1, 0.3, (1, 7)), (2, 1)),
        "vndf": random.uniform(0.2, 1.0, (1, 5, 9, 21)),
        "luminance": random.uniform(0.5, 1.0, (1, 5, 6, 6)),
        "rgb": random.uniform(0.1, 1.0, (1, 5, 3, 6, 6)),
        "theta_i": angles,
        "phi_i": np.zeros(1),
    }
    fields: dict[str, NDArray[Any]] = {name: table.astype(np.float32) for name, table in tables.items()}
    return fields | {"description": np.frombuffer(b"random", np.uint8), "jacobian": np.ones(1, np.uint8)}


def pairs_of_directions(number: int) -> tuple[Array, Array]:
    random = np.random.default_rng(1)
    cosine, turn = random.uniform(0.03, 1.0, (2, number)), random.uniform(0.0, 2.0 * np.pi, (2, number))
    sine = np.sqrt(1.0 - cosine**2)
    first, second = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1)
    return first, second


@pytest.mark.parametrize("content", [encode_tensors(random_fields()), rgl_bsdf(MODEL)], ids=["random", "model"])
def test_values_are_those_of_mitsuba(mitsuba: ModuleType, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "material.bsdf"
    path.write_bytes(content)
    bsdf = mitsuba.load_dict({"type": "measured", "filename": str(path)})
    surface, context = mitsuba.SurfaceInteraction3f(), mitsuba.BSDFContext()
    first, second = pairs_of_directions(300)
    expected = []
    for omega_in, omega_out in zip(first.tolist(), second.tolist(), strict=True):
        surface.wi = omega_in
        expected.append(np.array(bsdf.eval(context, surface, omega_out), dtype=float))
    values = read_rgl(path).evaluate_directions(first, second) * second[:, 2:]
    error = np.abs(values / np.array(expected) - 1.0)
    assert np.median(error) < 1e-5
    assert np.quantile(error, 0.99) < 1e-3  # Mitsuba has single precision


def test_measurement_is_what_the_file_was_made_of() -> None:
    measurement = parse_rgl(rgl_bsdf(MODEL), "blue").measurement()
    assert measurement.name == "blue"
    i, j, k = (part.ravel() for part in np.mgrid[1:80:9, 0:70:10, 0:180:20])
    chosen = measurement.valid[i, j, k]
    assert chosen.mean() > 0.6
    i, j, k = i[chosen], j[chosen], k[chosen]
    expected = MODEL.evaluate(THETA_HALF[i], THETA_DIFF[j], PHI_DIFF[k])
    assert np.median(np.abs(measurement.values[:, i, j, k].T / expected - 1.0)) < 0.01


def test_below_the_horizon_there_is_nothing() -> None:
    material = parse_rgl(encode_tensors(random_fields()))
    values = material.evaluate_directions(np.array([[0.6, 0.0, 0.8]]), np.array([[0.6, 0.0, -0.8]]))
    assert not values.any()


def changed(**fields: Any) -> bytes:
    whole = random_fields() | fields
    return encode_tensors({name: array for name, array in whole.items() if array is not None})


ANGLES = random_fields()["theta_i"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x89PNG\r\n", "The data is a PNG image; a material of the RGL data base is a .bsdf file"),
        (b"", "not a tensor file"),
        (changed()[:3000], "damaged or cut off"),
        (changed(phi_i=np.linspace(0, 6, 8, dtype=np.float32)), "is anisotropic: it has 8 azimuths"),
        (changed(rgb=None, spectra=np.zeros((1, 5, 9, 4, 4), np.float32)), "has spectra; use the file .* ends in _rgb"),
        (changed(vndf=None), "no field 'vndf'"),
        (changed(ndf=np.ones(3, np.float32)), "'ndf' .* not an array with 2 axes"),
        (changed(ndf=np.full((2, 2), np.nan, np.float32)), "'ndf' .* NaN or infinite"),
        (changed(theta_i=ANGLES[:4]), "do not fit together"),
        (changed(theta_i=ANGLES[::-1].copy()), "must ascend"),
        (changed(sigma=np.zeros((2, 2), np.float32)), "is not positive"),
        (changed(rgb=np.zeros((1, 5, 3, 6, 6), np.float32)), "Every value .* is zero"),
    ],
)
def test_what_is_no_isotropic_material_is_refused(content: bytes, words: str) -> None:
    with pytest.raises(MeasurementFormatError, match=words):
        parse_rgl(content)


def test_the_tables_are_those_of_the_file() -> None:
    fields = parse_tensors(changed())
    np.testing.assert_array_equal(parse_rgl(changed()).rgb, fields["rgb"][0])
