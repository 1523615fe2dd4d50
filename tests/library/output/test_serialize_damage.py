"""Files and texts from strangers: whatever comes, the readers answer with a model or with one sentence."""

import io
import json
import pickle
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dsbrdf.errors import ModelFormatError
from dsbrdf.fitting.report import FitReport
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.serialize import from_json, from_npz, load, to_json, to_npz
from tests.support.models import ARRAYS, TEXTS
from tests.support.strategies import MODEL, arrays, examples

Document = dict[str, Any]


def _set(*path: Any, value: Any = ...) -> Callable[[Document], None]:
    """A change of the value at a place; without one, the place goes."""

    def change(document: Document) -> None:
        place: Any = document
        for key in path[:-1]:
            place = place[key]
        if value is ...:
            del place[path[-1]]
        else:
            place[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("format"), "its format is not 'dsbrdf'"),
        (_set("format", value="other"), "its format is not 'dsbrdf'"),
        (_set("version"), "no valid version"),
        *((_set("version", value=bad), "no valid version") for bad in ("1", True, 0)),
        *((_set("version", value=n), f"version {n}; this release reads version 2") for n in (1, 3)),
        (_set("model"), "lacks the key 'model'"),
        (_set("report"), "lacks the key 'report'"),
        (_set("model", value=[1]), "stored model must be a mapping"),
        *((_set("model", name), f"stored model lacks the key '{name}'") for name in (*ARRAYS, *TEXTS)),
        (_set("model", "extra", value=1), "stored model has the unknown key 'extra'"),
        (_set("model", "amplitude", value=[[[1.0]]]), "amplitude must have shape"),
        (_set("model", "amplitude", 0, value=[1.0]), "amplitude is not a regular array"),
        *(
            (_set("model", "kappa", 0, 0, 0, value=bad), "kappa is not an array of real")
            for bad in ("1.0", None, 10**400)
        ),
        (_set("model", "gamma", 0, 4, 2, value=-1.0), "every gamma must be positive"),
        (_set("model", "gamma", 0, 4, 2, value=np.nan), "contains NaN; every number must be finite"),
        (_set("model", "interpolation", value=3), "interpolation in the stored model is not a text"),
        (_set("model", "interpolation", value="magic"), "interpolation must be one of"),
        (_set("model", "lobe", value=None), "lobe in the stored model is not a text"),
        (_set("report", value=3), "stored report must be a mapping"),
        (_set("report", "metrics"), "stored report lacks the key 'metrics'"),
        (_set("report", "metrics", value=[]), "stored report.metrics must be a mapping"),
        (_set("report", "metrics", "male"), "stored report.metrics lacks the key 'male'"),
        *(
            (_set("report", "metrics", "male", value=bad), f"report.metrics.male is of the wrong kind, {kind}")
            for bad, kind in (("0.1", "str"), (True, "bool"), (10**400, "int"))
        ),
        (_set("report", "n_numbers", value=True), "stored report.n_numbers is of the wrong kind, bool"),
        (_set("report", "growth", value={}), "stored report.growth is of the wrong kind, dict"),
        (_set("report", "timings", "em", value=None), "stored report.timings.em is of the wrong kind, NoneType"),
        (_set("report", "by_theta_diff", 0, "theta_diff", value=[0.0]), "theta_diff has 1 values, not 2"),
        (_set("report", "options", "method", value="magic"), "options.method is of the wrong kind, str"),
        (_set("report", "options", "n_lobes", value=99), "options in the stored report are not valid: n_lobes"),
        (_set("report", "extra", value=1), "stored report has the unknown key 'extra'"),
    ],
)
def test_damaged_json_is_named(
    model: DSBRDF, report: FitReport, change: Callable[[Document], None], message: str
) -> None:
    document = json.loads(to_json(model, report))
    change(document)
    with pytest.raises(ModelFormatError, match=message):
        from_json(json.dumps(document))


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["", "{", "\x80", "[" * 100_000, "1" * 5000], "not valid JSON"),
        (["[]", "null"], "not an object"),
        (["{}"], "its format is not 'dsbrdf'"),
    ],
)
def test_text_that_is_not_a_model(texts: list[str], message: str) -> None:
    for text in texts:
        with pytest.raises(ModelFormatError, match=message):
            from_json(text)


def npz(**content: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **content)
    return buffer.getvalue()


def unpacked(data: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(data)) as archive:
        return dict(archive)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": None}, "its format is not 'dsbrdf'"),
        ({"format": np.array(["dsbrdf"])}, "its format is not 'dsbrdf'"),
        ({"version": None}, "no valid version"),
        ({"version": np.array(1.0)}, "no valid version"),
        ({"report": None}, "lacks the key 'report'"),
        ({"report": np.array(1)}, "report in the stored model is not a text"),
        *(({name: None}, f"lacks the key '{name}'") for name in TEXTS),
        *(({name: np.array(1)}, f"{name} in the stored model is not a text") for name in TEXTS),
        ({"extra": np.array(1)}, "unknown key 'extra'"),
        ({"delta": None}, "lacks the key 'delta'"),
        ({"gamma": np.array(np.nan)}, "stored model is not valid"),
        ({"center": np.array("text")}, "center is not an array of real numbers"),
        ({"kappa": np.ones((3, 5, 3), dtype=complex)}, "kappa is not an array of real numbers"),
    ],
)
def test_damaged_npz_is_named(model: DSBRDF, changes: dict[str, Any], message: str) -> None:
    content = unpacked(to_npz(model)) | changes
    with pytest.raises(ModelFormatError, match=message):
        from_npz(npz(**{name: value for name, value in content.items() if value is not None}))


class Trap:
    """Fails the test if anything unpickles it."""

    def __reduce__(self) -> tuple[Any, ...]:
        return pytest.fail, ("a pickle was executed",)


def test_pickled_arrays_are_refused(model: DSBRDF, tmp_path: Path) -> None:
    content = unpacked(to_npz(model))
    trapped = npz(**(content | {"kappa": np.array([Trap()], dtype=object)}))
    for data in (trapped, pickle.dumps(Trap())):
        with pytest.raises(ModelFormatError, match=r"not a readable \.npz archive of plain arrays"):
            from_npz(data)
        (tmp_path / "trap.npz").write_bytes(data)
        with pytest.raises(ModelFormatError):
            load(tmp_path / "trap.npz")


def test_truncated_npz_is_refused(model: DSBRDF) -> None:
    data = to_npz(model)
    for length in [*range(0, len(data), 61), len(data) - 1]:
        with pytest.raises(ModelFormatError, match="not a readable"):
            from_npz(data[:length])


def test_other_files_are_refused(model: DSBRDF, tmp_path: Path) -> None:
    plain = io.BytesIO()
    np.save(plain, np.zeros(3))
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("kappa.npy", bytes(100_000_000))
    for data, message in ((plain.getvalue(), "not a readable"), (bomb.getvalue(), "unpacks to 100000000 bytes")):
        with pytest.raises(ModelFormatError, match=message):
            from_npz(data)
    path = tmp_path / "model.json"
    path.write_bytes(to_npz(model))
    with pytest.raises(ModelFormatError, match="not a JSON text in UTF-8"):
        load(path)
    with path.open("wb") as file:
        file.truncate(10 << 30)
    with pytest.raises(ModelFormatError, match="longer than the 67108864 bytes"):
        load(path)


def check(read: Callable[[Any], tuple[DSBRDF, Any]], data: str | bytes) -> None:
    """Read a stored model, which either is refused in a sentence, or works and comes back the same."""
    try:
        model, _ = read(data)
    except ModelFormatError as error:
        said = str(error)
    else:
        assert np.isfinite(model.evaluate([0.0, 0.5, 1.57], [0.0, 0.5, 1.57])).all()
        assert to_json(from_json(to_json(model))[0]) == to_json(model)
        return
    assert 10 < len(said) < 1000
    assert "\n" not in said


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


PLACES = list(places(json.loads(to_json(MODEL))))


@given(st.lists(st.tuples(st.sampled_from(PLACES), st.one_of(json_values, st.just(...))), max_size=5))
def test_changed_json_document_is_refused_or_valid(changes: list[tuple[tuple[Any, ...], Any]]) -> None:
    document = json.loads(to_json(MODEL))
    for path, value in changes:
        with suppress(KeyError, IndexError, TypeError):  # an earlier change has taken the place away
            _set(*path, value=value)(document)
    check(from_json, json.dumps(document))


@examples(2)
@given(
    st.dictionaries(
        st.sampled_from(["kappa", "delta", "theta_diff", "report", "version", "format", "interpolation", "x"]),
        st.one_of(st.none(), st.binary(max_size=60), arrays()),
        min_size=1,
    )
)
def test_npz_of_arbitrary_arrays_is_refused_or_valid(changed: dict[str, bytes | None]) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(to_npz(MODEL))) as source, zipfile.ZipFile(buffer, "w") as target:
        kept = {name.removesuffix(".npy"): source.read(name) for name in source.namelist()}
        for name, content in {**kept, **changed}.items():
            if content is not None:
                target.writestr(f"{name}.npy", content)
    check(from_npz, buffer.getvalue())
