"""Bytes from strangers: whatever comes, the readers answer with a result or with their one error.

`pytest --hypothesis-profile=soak` runs the same with many more examples.
"""

import hashlib
import io
import json
import struct
import zipfile
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dsbrdf import DSBRDF, MeasurementFormatError, ModelFormatError
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import FILE_SIZE, MerlChecker, encode_merl, parse_merl
from dsbrdf.output.serialize import from_json, from_npz, to_json, to_npz
from tests.conftest import examples

HEADER = struct.pack("<3i", 90, 90, 180)
SPECIAL = (np.nan, np.inf, -np.inf, -1.0, -0.0, 0.0, 5e-324, 1.7e308, 1.5e11, -1.7e308)
MODEL = DSBRDF(
    theta_diff=np.array([0.0, 0.7, 1.5]),
    kappa=np.full((3, 3, 2), 0.3),
    gamma=np.full((3, 3, 2), 4.0),
    center=np.zeros((3, 3, 2)),
    delta=np.zeros((3, 3)),
    interpolation="cubic",
)


# Measurements


def whole(data: bytes) -> str:
    """The sha256 and the number of valid nodes of a file read at once, or the sentence that refuses it."""
    try:
        measurement = parse_merl(data)
    except MeasurementFormatError as error:
        return str(error)
    return f"{measurement.sha256} {measurement.valid.sum()}"


def in_pieces(data: bytes, cuts: list[int]) -> str:
    """The same of a file that arrives in pieces."""
    checker = MerlChecker()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    try:
        for start, end in pairwise(edges):
            checker.update(data[start:end])
        valid = checker.finish()
    except MeasurementFormatError as error:
        return str(error)
    return f"{hashlib.sha256(data).hexdigest()} {valid.sum()}"


near_an_end = st.one_of(st.integers(0, 64), st.integers(FILE_SIZE - 64, FILE_SIZE + 64), st.integers(0, FILE_SIZE))
cut_places = st.lists(near_an_end, max_size=40)


@pytest.fixture(scope="module")
def file(plastic: Measurement) -> bytes:
    return encode_merl(plastic)


@st.composite
def damages(draw: st.DrawFn) -> list[tuple[int, bytes]]:
    """Places in a file and what to write there: bytes, or numbers with a meaning."""
    number = st.sampled_from(SPECIAL).map(lambda value: struct.pack("<d", value))
    run = st.tuples(number, st.sampled_from([1, 3, 70_000, 1_458_000])).map(lambda part: part[0] * part[1])
    value_place = st.integers(0, 3 * 90 * 90 * 180 - 1).map(lambda index: 12 + 8 * index)
    anywhere = st.tuples(near_an_end, st.binary(min_size=1, max_size=40))
    dimension = st.tuples(
        st.sampled_from([0, 4, 8]), st.integers(-(2**31), 2**31 - 1).map(lambda n: struct.pack("<i", n))
    )
    return draw(st.lists(st.one_of(st.tuples(value_place, run), anywhere, dimension), max_size=3))


@examples(0.3)
@given(damage=damages(), length=st.one_of(st.just(FILE_SIZE), near_an_end), cuts=cut_places)
def test_a_damaged_file_gets_one_verdict_whatever_the_pieces(
    file: bytes, damage: list[tuple[int, bytes]], length: int, cuts: list[int]
) -> None:
    changed = bytearray(file)
    for place, content in damage:
        changed[place : place + len(content)] = content
    data = bytes(changed[:length]).ljust(min(length, FILE_SIZE + 64), b"\0")
    assert in_pieces(data, cuts) == whole(data)


@examples(3)
@given(data=st.one_of(st.binary(max_size=80), st.binary(max_size=80).map(HEADER.__add__)), cuts=cut_places)
def test_a_few_bytes_are_never_a_measurement(data: bytes, cuts: list[int]) -> None:
    with pytest.raises(MeasurementFormatError):
        parse_merl(data)
    assert in_pieces(data, cuts) == whole(data)


# Models


def check_text(text: str) -> None:
    """Read a stored model, which either is refused or can be used."""
    try:
        model, _ = from_json(text)
    except ModelFormatError as error:
        check_sentence(error)
        return
    check_model(model)


def check_archive(data: bytes) -> None:
    try:
        model, _ = from_npz(data)
    except ModelFormatError as error:
        check_sentence(error)
        return
    check_model(model)


def check_sentence(error: ModelFormatError) -> None:
    assert 10 < len(str(error)) < 1000
    assert "\n" not in str(error)


def check_model(model: DSBRDF) -> None:
    """An accepted model is one that works, and comes back the same."""
    assert np.isfinite(model.evaluate([0.0, 0.5, 1.57], [0.0, 0.5, 1.57])).all()
    assert to_json(from_json(to_json(model))[0]) == to_json(model)


numbers = st.one_of(st.integers(), st.floats(), st.sampled_from([0, 1, 1e-320, 1e308, 10**400, 1.5707]))
json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, st.text(max_size=8)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.sampled_from(["model", "kappa", "x", ""]), inner, max_size=3)
    ),
    max_leaves=12,
)


def places(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every value in a JSON document."""
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in children:
        yield (*path, key)
        yield from places(value, (*path, key))


DOCUMENT = json.loads(to_json(MODEL))
PLACES = list(places(DOCUMENT))


@examples(3)
@given(
    changes=st.lists(st.tuples(st.sampled_from(PLACES), st.one_of(numbers, json_values)), max_size=3),
    dropped=st.lists(st.sampled_from(PLACES), max_size=2),
)
def test_a_changed_document_is_refused_or_works(
    changes: list[tuple[tuple[Any, ...], Any]], dropped: list[tuple[Any, ...]]
) -> None:
    document = json.loads(to_json(MODEL))
    for path, value in [*changes, *((path, ...) for path in dropped)]:
        node = document
        try:
            for key in path[:-1]:
                node = node[key]
            if value is ...:
                del node[path[-1]]
            else:
                node[path[-1]] = value
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change has taken the place away
    check_text(json.dumps(document))


@examples(3)
@given(
    start=st.integers(0, 400),
    removed=st.integers(0, 40),
    inserted=st.one_of(
        st.text(max_size=20), st.sampled_from(["[" * 100_000, "9" * 6000, "1e999", "NaN", '{"a":' * 9999])
    ),
)
def test_a_damaged_text_is_refused_or_works(start: int, removed: int, inserted: str) -> None:
    text = to_json(MODEL)
    check_text(text[:start] + inserted + text[start + removed :])


@examples(1)
@given(st.one_of(st.text(), json_values.map(json.dumps)))
def test_other_text_is_refused(text: str) -> None:
    with pytest.raises(ModelFormatError):
        from_json(text)


ARCHIVE = to_npz(MODEL)


@examples(5)
@given(
    changes=st.lists(st.tuples(st.integers(0, len(ARCHIVE)), st.binary(max_size=8)), max_size=4),
    length=st.one_of(st.just(len(ARCHIVE)), st.integers(0, len(ARCHIVE))),
)
def test_a_damaged_archive_is_refused_or_works(changes: list[tuple[int, bytes]], length: int) -> None:
    data = bytearray(ARCHIVE)
    for place, content in changes:
        data[place : place + len(content)] = content
    check_archive(bytes(data[:length]))


@st.composite
def arrays(draw: st.DrawFn) -> bytes:
    """A .npy file whose header promises anything."""
    shape = draw(st.lists(st.one_of(st.integers(0, 4), st.integers(-2, 2**62)), max_size=4).map(tuple))
    kind = draw(
        st.sampled_from(["<f8", ">f8", "<f2", "<i8", "|O", "<U9", "|b1", "<c16", "|V8", "<M8[s]", "|S0", "x", ""])
    )
    header = draw(
        st.one_of(
            st.just(f"{{'descr': {kind!r}, 'fortran_order': {draw(st.booleans())}, 'shape': {shape}, }}"),
            st.text(st.characters(codec="latin-1"), max_size=60),
        )
    ).encode("latin-1")
    version = draw(st.sampled_from([b"\1\0", b"\2\0", b"\3\0", b"\0\0", b"\xff\xff"]))
    length = struct.pack("<H" if version == b"\1\0" else "<I", draw(st.sampled_from([len(header), 0, 65535])))
    values = draw(st.one_of(st.binary(max_size=200), st.just(np.full(18, 0.5).tobytes())))
    return b"\x93NUMPY" + version + length + header + values


@examples(5)
@given(
    changed=st.dictionaries(
        st.sampled_from(["kappa", "delta", "theta_diff", "report", "version", "format", "interpolation", "x"]),
        st.one_of(st.none(), st.binary(max_size=60), arrays()),
        min_size=1,
    )
)
def test_an_archive_of_odd_arrays_is_refused_or_works(changed: dict[str, bytes | None]) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(ARCHIVE)) as source, zipfile.ZipFile(buffer, "w") as target:
        kept = {name.removesuffix(".npy"): source.read(name) for name in source.namelist()}
        for name, content in {**kept, **changed}.items():
            if content is not None:
                target.writestr(f"{name}.npy", content)
    check_archive(buffer.getvalue())


@examples(1)
@given(st.binary(max_size=300))
def test_other_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(ModelFormatError):
        from_npz(data)
