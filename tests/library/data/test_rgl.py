import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf import MeasurementFormatError
from dsbrdf.data import parse_rgl, read_rgl, spherical
from dsbrdf.data.rgl import Warp, encode_tensors, parse_tensors
from dsbrdf.output.export.rgl import rgl_bsdf
from tests.support.known_models import pairs_of_directions
from tests.support.mitsuba_variants import mitsuba_variant
from tests.support.mixtures import mixture

MODEL = mixture(2, 1)


@cache
def of_model() -> bytes:
    return rgl_bsdf(MODEL)


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


@pytest.mark.parametrize("content", [lambda: encode_tensors(random_fields()), of_model], ids=["random", "model"])
def test_values_are_those_of_mitsuba(tmp_path: Path, content: Callable[[], bytes]) -> None:
    path, mitsuba = tmp_path / "material.bsdf", mitsuba_variant("scalar_rgb")
    path.write_bytes(content())
    bsdf = mitsuba.load_dict({"type": "measured", "filename": str(path)})
    surface, context = mitsuba.SurfaceInteraction3f(), mitsuba.BSDFContext()
    first, second = pairs_of_directions(300, lowest=0.03, spread=None)
    expected = []
    for omega_in, omega_out in zip(first.tolist(), second.tolist(), strict=True):
        surface.wi = omega_in
        expected.append(np.array(bsdf.eval(context, surface, omega_out), dtype=float))
    values = read_rgl(path).evaluate_directions(first, second) * second[:, 2:]
    error = np.abs(values / np.array(expected) - 1.0)
    assert np.median(error) < 1e-5
    assert np.quantile(error, 0.99) < 1e-3  # Mitsuba has single precision


def test_non_reciprocity_is_the_median_difference_of_pairs_up_to_75_degrees_a_quarter_of_them_mirrored() -> None:
    fields = parse_tensors(of_model())
    brighter = 1.0 + 1.5 * fields["theta_i"] ** 2  # in one order of the directions
    rgb = (fields["rgb"] * brighter[:, None, None, None]).astype(np.float32)
    material, random = parse_rgl(encode_tensors({**fields, "rgb": rgb})), np.random.default_rng(1)
    theta = np.arccos(random.uniform(np.cos(np.radians(75.0)), 1.0, (2, 20_000)))
    first, second = spherical(theta, random.uniform(0.0, 2.0 * np.pi, theta.shape))
    near = first[::4] * [-1.0, -1.0, 1.0] + random.normal(0.0, 0.05, first[::4].shape)
    second[::4] = near / np.linalg.norm(near, axis=1)[:, None]
    one, other = (material.evaluate_directions(*pair).mean(axis=1) for pair in ((first, second), (second, first)))
    expected = np.median(np.abs(one - other) / (0.5 * (one + other)))
    assert material.non_reciprocity() == pytest.approx(expected, rel=0.04)
    assert parse_rgl(of_model()).non_reciprocity() < 0.01


def test_below_the_horizon_there_is_nothing() -> None:
    material = parse_rgl(encode_tensors(random_fields()))
    assert not material.evaluate_directions(np.array([[0.6, 0.0, 0.8]]), np.array([[0.6, 0.0, -0.8]])).any()


def changed(**fields: Any) -> bytes:
    whole = random_fields() | fields
    return encode_tensors({name: array for name, array in whole.items() if array is not None})


ANGLES = random_fields()["theta_i"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x89PNG\r\n", "The data is a PNG image; a picture has no directions"),
        *((content, r"not a tensor file of version 1\.0") for content in (b"", b"tensor_file\0\x02\x00" + bytes(99))),
        (changed(phi_i=np.linspace(0, 6, 8, dtype=np.float32)), "is anisotropic: it has 8 azimuths"),
        (changed(rgb=None, spectra=np.zeros((1, 5, 9, 4, 4), np.float32)), "has spectra; use the file .* ends in _rgb"),
        (changed(vndf=None), "lacks the field 'vndf'"),
        (changed(ndf=np.ones(3, np.float32)), "'ndf' .* not an array with 2 axes"),
        (changed(ndf=np.full((2, 2), np.nan, np.float32)), "'ndf' .* NaN or infinite"),
        (changed(theta_i=ANGLES[:4]), "have inconsistent shapes"),
        (changed(theta_i=ANGLES[::-1].copy()), "must ascend"),
        (changed(sigma=np.zeros((2, 2), np.float32)), "is not positive"),
        (changed(rgb=np.zeros((1, 5, 3, 6, 6), np.float32)), "Every value .* is zero"),
    ],
)
def test_what_is_no_isotropic_material_is_refused(content: bytes, words: str) -> None:
    with pytest.raises(MeasurementFormatError, match=words):
        parse_rgl(content)


def test_samples_are_inverted_up_to_the_corners() -> None:
    random = np.random.default_rng(2)
    for table in (random.random((5, 7)), np.full((5, 7), 3.0)):
        given = np.hstack([random.random((2, 100)), [[0.0, 1.0], [0.0, 1.0]]])
        x, y = Warp.of(table).sample(*given)
        first = np.zeros(102)
        np.testing.assert_allclose(Warp.of(table[None]).invert(first.astype(int), first, x, y), given, atol=1e-12)
        assert (x[-2:].tolist(), y[-2:].tolist()) == ([0.0, 1.0], [0.0, 1.0])


def test_round_trip_and_files_that_are_cut() -> None:
    fields = random_fields() | {"double": np.arange(24.0).reshape(2, 3, 4)}
    content = encode_tensors(fields)
    found = parse_tensors(content)
    assert list(found) == list(fields)
    for name, array in fields.items():
        assert found[name].dtype == array.dtype
        assert np.array_equal(found[name], array)
    head = b"tensor_file\0\x01\x00" + struct.pack("<IHsHB", 1, 1, b"a", 2, 10)
    endless = (head + struct.pack("<QQQ", 0, *shape) for shape in ((1 << 62, 1 << 62), (100, 100)))
    for damaged in (*(content[:length] for length in (*range(14, 400, 7), len(content) - 1)), *endless):
        with pytest.raises(MeasurementFormatError, match="damaged or cut off"):
            parse_tensors(damaged)


def test_layout() -> None:
    expected = b"tensor_file\0\x01\x00" + struct.pack("<I", 1) + struct.pack("<H", 1) + b"a"
    expected += struct.pack("<HBQQ", 1, 10, 40, 1) + struct.pack("<f", 2.5)
    assert encode_tensors({"a": np.array([2.5], np.float32)}) == expected
