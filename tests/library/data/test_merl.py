"""Files of measurements, MERL's and RGL's: what is read and written, by the formats and by Mitsuba."""

import hashlib
import os
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf import Measurement, MeasurementFormatError, parse_merl, read_merl, write_merl
from dsbrdf.data import CHANNELS, FILE_SIZE, GRID_SHAPE, PHI_DIFF, THETA_DIFF, THETA_HALF, encode_merl
from dsbrdf.data.files import write_atomically
from dsbrdf.data.geometry import directions, nodes_above_horizon, spherical
from dsbrdf.data.merl import map_merl
from dsbrdf.data.rgl import Warp, encode_tensors, parse_rgl, parse_tensors, read_rgl
from dsbrdf.output.export.rgl import rgl_bsdf
from tests.support.merl_files import ABOVE, BELOW, HEADER, position, with_values
from tests.support.models import mixture, pairs_of_directions
from tests.support.renderers import mitsuba_variant


def test_file_layout_is_that_of_the_merl_format(data: bytes, plastic: Measurement) -> None:
    assert data[:12] == HEADER
    assert len(data) == FILE_SIZE == 34_992_012
    for channel, node in ((0, (0, 0, 0)), (1, (3, 4, 5)), (2, (89, 89, 179))):
        assert plastic.stored[channel][node] == struct.unpack_from("<d", data, position(channel, node))[0]
    for values, stored, factor in zip(plastic.values, plastic.stored, (1.0, 1.15, 1.66), strict=True):
        np.testing.assert_allclose(values, stored * factor / 1500.0, rtol=4e-16)


def test_round_trip_is_bit_for_bit(data: bytes, plastic_file: Path, tmp_path: Path) -> None:
    measurement = read_merl(plastic_file)
    assert measurement.name == "plastic"
    assert measurement.sha256 == hashlib.sha256(data).hexdigest()
    assert encode_merl(measurement) == data
    copy = tmp_path / "copy.binary"
    write_merl(copy, measurement)
    assert copy.read_bytes() == data
    assert [path.name for path in tmp_path.iterdir()] == ["copy.binary"]


def test_unusual_valid_bit_patterns_survive(data: bytes) -> None:
    changes = {(0, ABOVE): -0.0, (1, ABOVE): 5e-324, (2, BELOW): -1e300, (0, (0, 0, 0)): -7.25}
    changed = with_values(data, changes)
    measurement = parse_merl(changed)
    assert encode_merl(measurement) == changed
    assert measurement.valid[ABOVE]
    assert measurement.values[0, 0, 0, 0] == 0.0


def test_immutable_bytes_are_shared_and_mutable_buffers_copied(data: bytes) -> None:
    assert np.shares_memory(parse_merl(data).stored, np.frombuffer(data, dtype=np.uint8))
    buffer = bytearray(data)
    measurement = parse_merl(buffer)
    buffer[position(0, ABOVE) : position(0, ABOVE) + 8] = bytes(8)
    assert measurement.stored[0][ABOVE] == parse_merl(data).stored[0][ABOVE]
    assert parse_merl(memoryview(data), "view").name == "view"


def test_failed_write_keeps_the_existing_file(tmp_path: Path) -> None:
    path = tmp_path / "kept.binary"
    path.write_bytes(b"before")
    with pytest.raises(MeasurementFormatError):
        write_merl(path, np.full((3, *GRID_SHAPE), np.nan))
    with pytest.raises(TypeError):
        write_atomically(path, [b"half", None])  # type: ignore[list-item]
    with Path("/dev/full").open("wb", 0) as disk, pytest.raises(OSError, match=r"kept\.binary"):
        write_atomically(path, (disk.write(b"half").to_bytes() for _ in range(2)))
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]
    old = tmp_path / "old"
    os.link(path, old)
    write_merl(path, np.ones((3, *GRID_SHAPE)))
    assert old.read_bytes() == b"before"  # another file takes the place, once it is whole
    with pytest.raises(FileNotFoundError):
        write_merl(tmp_path / "missing" / "a.binary", np.ones((3, *GRID_SHAPE)))


def test_written_files_have_ordinary_permissions_and_names_of_any_length(tmp_path: Path) -> None:
    (tmp_path / "b").write_bytes(b"")
    for name in ("a", "\N{GLOWING STAR}" * 63, "a" * 255):
        write_atomically(tmp_path / name, [b"whole"])
        assert (tmp_path / name).stat().st_mode == (tmp_path / "b").stat().st_mode
    with pytest.raises(IsADirectoryError):
        write_atomically(tmp_path, [b"whole"])


def test_valid_needs_a_channel_and_the_horizon(data: bytes) -> None:
    changes = {(0, (1, 1, 1)): -1.0, (1, (1, 1, 1)): -1e-300, (2, (1, 1, 1)): -5.0, (2, (2, 2, 2)): -1.0}
    changes |= {(0, BELOW): 3.0, (1, BELOW): 3.0, (2, BELOW): 3.0, (0, (4, 4, 4)): 0.0}
    measurement = parse_merl(with_values(data, changes))
    expected = nodes_above_horizon().copy()
    expected[1, 1, 1] = False
    np.testing.assert_array_equal(measurement.valid, expected)
    assert measurement.values[2, 2, 2, 2] == 0.0


def test_mapped_file_is_what_is_read(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "whole.binary"
    path.write_bytes(with_values(data, {(0, ABOVE): -1.0}))  # A node counts if any channel has a value there.
    read = read_merl(path)
    mapped = map_merl(path, read.sha256)
    np.testing.assert_array_equal(mapped.stored, read.stored)
    np.testing.assert_array_equal(mapped.valid, read.valid)
    assert (mapped.name, mapped.sha256) == (read.name, read.sha256)
    assert not mapped.stored.flags.writeable
    assert not mapped.valid.flags.writeable
    short = tmp_path / "short.binary"
    short.write_bytes(data[:-8])
    with pytest.raises(ValueError, match="length"):
        map_merl(short, read.sha256)


def test_grid_stands_at_the_left_edges() -> None:
    assert CHANNELS == ("red", "green", "blue")
    assert GRID_SHAPE == (len(THETA_HALF), len(THETA_DIFF), len(PHI_DIFF))
    np.testing.assert_allclose(np.degrees(THETA_HALF[[0, 1, 30, 89]]), [0.0, 1 / 90, 10.0, 89**2 / 90])
    np.testing.assert_allclose(np.degrees(THETA_DIFF[[0, 1, 89]]), [0.0, 1.0, 89.0])
    np.testing.assert_allclose(np.degrees(PHI_DIFF[[0, 1, 179]]), [0.0, 1.0, 179.0])


def test_nodes_above_horizon_agree_with_the_directions() -> None:
    above = nodes_above_horizon()
    assert above.shape == GRID_SHAPE
    omega_in, omega_out = directions(THETA_HALF[::7, None, None], THETA_DIFF[::3, None], PHI_DIFF[::5])
    expected = (omega_in[..., 2] > 1e-13) & (omega_out[..., 2] > 1e-13)
    np.testing.assert_array_equal(above[::7, ::3, ::5], expected)
    assert not above[30, 80, 0]  # 10 + 80 degrees: on the horizon


def test_from_values_equals_reading_the_encoded_bytes() -> None:
    values = np.random.default_rng(3).uniform(0.1, 5.0, (3, *GRID_SHAPE))
    values[:, 4, 5, 6] = -2.0
    valid = np.ones(GRID_SHAPE, dtype=bool)
    valid[7, 8, 9] = False
    values[:, 7, 8, 9] = np.nan  # what an invalid node holds does not matter
    measurement = Measurement.from_values(values, valid, name="random")
    expected = nodes_above_horizon().copy()
    expected[4, 5, 6] = expected[7, 8, 9] = False
    np.testing.assert_array_equal(measurement.valid, expected)
    np.testing.assert_allclose(measurement.values[:, valid], values[:, valid], rtol=5e-16)
    np.testing.assert_array_equal(measurement.stored[:, 7, 8, 9], -1.0)
    assert not any(array.flags.writeable for array in (measurement.stored, measurement.valid, measurement.scale))
    assert measurement.name == "random"
    assert measurement.sha256 == hashlib.sha256(encode_merl(measurement)).hexdigest()


def test_from_values_names_the_fault() -> None:
    zeros, ones = np.zeros((3, *GRID_SHAPE)), np.ones((3, *GRID_SHAPE))
    wrong: list[tuple[Any, Any, str]] = [
        (np.moveaxis(zeros, 0, -1), None, r"have the shape \(.*; a measurement has \(3, 90, 90, 180\)"),
        (ones, np.ones((90, 180, 90), bool), r"valid nodes have the shape \(90, 180, 90\)"),
        (zeros, None, "have a value of at least"),
        (np.array([["a"]]), None, "must be real numbers"),
        ({"values": ones}, None, "an object of type dict has no such numbers"),
        (np.where(np.arange(180) == 7, np.inf, ones), None, "^24300 of the values are NaN"),
    ]
    for values, valid, words in wrong:
        with pytest.raises(MeasurementFormatError, match=words):
            Measurement.from_values(values, valid)


@cache
def of_model() -> bytes:
    return rgl_bsdf(mixture(2, 1))


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
    material = parse_rgl(changed(phi_i=np.zeros(2, np.float32)))  # Two are isotropic, as in Mitsuba.
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
        (changed(phi_i=np.linspace(0, 4, 3, dtype=np.float32)), "is anisotropic: it has 3 azimuths"),
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


def test_layout_round_trip_and_files_that_are_cut() -> None:
    expected = b"tensor_file\0\x01\x00" + struct.pack("<I", 1) + struct.pack("<H", 1) + b"a"
    expected += struct.pack("<HBQQ", 1, 10, 40, 1) + struct.pack("<f", 2.5)
    assert encode_tensors({"a": np.array([2.5], np.float32)}) == expected
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
