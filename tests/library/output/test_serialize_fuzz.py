"""Bytes from strangers: whatever comes, the readers answer with a result or with their one error.

`pytest --hypothesis-profile=soak` runs the same with many more examples.
"""

import io
import json
import zipfile
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dsbrdf import DSBRDF, ModelFormatError
from dsbrdf.output.serialize import from_json, from_npz, to_json, to_npz
from tests.support.strategies import MODEL, arrays, examples


def check(read: Callable[[Any], tuple[DSBRDF, Any]], data: str | bytes) -> None:
    """Read a stored model, which either is refused in a sentence, or works and comes back the same."""
    try:
        model, _ = read(data)
    except ModelFormatError as error:
        sentence = str(error)
    else:
        assert np.isfinite(model.evaluate([0.0, 0.5, 1.57], [0.0, 0.5, 1.57])).all()
        assert to_json(from_json(to_json(model))[0]) == to_json(model)
        return
    assert 10 < len(sentence) < 1000
    assert "\n" not in sentence


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


@given(
    changes=st.lists(st.tuples(st.sampled_from(PLACES), json_values), max_size=3),
    dropped=st.lists(st.sampled_from(PLACES), max_size=2),
)
def test_changed_json_document_is_refused_or_valid(
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
    check(from_json, json.dumps(document))


@given(
    start=st.integers(0, 400),
    removed=st.integers(0, 40),
    inserted=st.one_of(
        st.text(max_size=20), st.sampled_from(["[" * 100_000, "9" * 6000, "1e999", "NaN", '{"a":' * 9999])
    ),
)
def test_damaged_json_text_is_refused_or_valid(start: int, removed: int, inserted: str) -> None:
    text = to_json(MODEL)
    check(from_json, text[:start] + inserted + text[start + removed :])


ARCHIVE = to_npz(MODEL)


@examples(2)
@given(
    changes=st.lists(st.tuples(st.integers(0, len(ARCHIVE)), st.binary(max_size=8)), max_size=4),
    length=st.one_of(st.just(len(ARCHIVE)), st.integers(0, len(ARCHIVE))),
)
def test_damaged_npz_is_refused_or_valid(changes: list[tuple[int, bytes]], length: int) -> None:
    data = bytearray(ARCHIVE)
    for place, content in changes:
        data[place : place + len(content)] = content
    check(from_npz, bytes(data[:length]))


@examples(2)
@given(
    changed=st.dictionaries(
        st.sampled_from(["kappa", "delta", "theta_diff", "report", "version", "format", "interpolation", "x"]),
        st.one_of(st.none(), st.binary(max_size=60), arrays()),
        min_size=1,
    )
)
def test_npz_of_arbitrary_arrays_is_refused_or_valid(changed: dict[str, bytes | None]) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(ARCHIVE)) as source, zipfile.ZipFile(buffer, "w") as target:
        kept = {name.removesuffix(".npy"): source.read(name) for name in source.namelist()}
        for name, content in {**kept, **changed}.items():
            if content is not None:
                target.writestr(f"{name}.npy", content)
    check(from_npz, buffer.getvalue())
