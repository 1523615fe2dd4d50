"""Finding materials, keeping what is computed of them, and computing several at once."""

import os
import threading
from pathlib import Path

import numpy as np
import pytest

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import save
from dsbrdf.paper import materials as module
from dsbrdf.paper.materials import Failure, Material, Numbers, choose, compute, find_materials


def name_length(material: Material) -> Numbers:
    """Numbers that take no time, and whether the process ends with its parent."""
    watched = any(thread.name == "end-with-parent" for thread in threading.enumerate())
    return {"length": np.array(len(material.name)), "process": np.array(os.getpid()), "watched": np.array(watched)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("merl_brass", "merl_nickel", "rgl_satin", "steel"):
        (tmp_path / f"{name}.binary").touch()
    return tmp_path


def test_materials_are_found_and_stand_ins_known_by_name(folder: Path) -> None:
    found = find_materials(folder, folder / "kept")
    assert [(one.name, one.measured) for one in found] == [
        ("merl_brass", False),
        ("merl_nickel", False),
        ("rgl_satin", True),
        ("steel", True),
    ]
    assert [one.measured for one in find_materials(folder, folder, stand_ins="rgl_*")] == [True, True, False, True]


def test_materials_can_be_named_with_or_without_their_data_base(folder: Path) -> None:
    assert [one.name for one in find_materials(folder, folder, names=["nickel", "steel"])] == ["merl_nickel", "steel"]
    assert [one.name for one in find_materials(folder, folder, names=["rgl_satin"])] == ["rgl_satin"]
    with pytest.raises(InvalidArgumentError, match="contains no material gold"):
        find_materials(folder, folder, names=["gold"])


def test_folder_without_measurements_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"contains no \.binary file"):
        find_materials(tmp_path, tmp_path)


def test_preferred_materials_come_first_and_others_fill_up(folder: Path) -> None:
    found = find_materials(folder, folder)
    assert [one.name for one in choose(found, ("steel", "gold", "nickel"), 2)] == ["steel", "merl_nickel"]
    assert [one.name for one in choose(found, ("nickel",), 3)] == ["merl_nickel", "merl_brass", "steel"]
    assert len(choose(found, (), 9)) == 4


def test_numbers_are_kept_until_something_changes(folder: Path) -> None:
    calls: list[str] = []

    def counted(material: Material) -> Numbers:
        calls.append(material.name)
        return {"number": np.arange(3.0)}

    found, kept = find_materials(folder, folder)[:2], folder / "numbers"
    first, failures = compute(found, counted, kept)
    assert failures == []
    assert [one.name for one in first] == calls == ["merl_brass", "merl_nickel"]
    compute(found, counted, kept)
    assert len(calls) == 2
    (kept / "merl_brass.npz").write_bytes(b"damaged")
    again, _ = compute(found, counted, kept)
    assert calls[2:] == ["merl_brass"]
    np.testing.assert_array_equal(again[0]["number"], np.arange(3.0))
    compute(found, counted, kept, settings="others")
    assert len(calls) == 5
    os.utime(found[1].file, (2e9, 2e9))
    compute(found, counted, kept, settings="others")
    assert calls[5:] == ["merl_nickel"]


def test_numbers_of_another_algorithm_are_computed_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, kept = find_materials(folder, folder)[:1], folder / "numbers"
    compute(found, name_length, kept)
    monkeypatch.setattr(module, "ALGORITHM_VERSION", "another")
    compute(found, lambda _: {"length": np.array(-1)}, kept)
    assert compute(found, name_length, kept)[0][0]["length"] == -1


def test_a_bad_file_does_not_stop_the_others(material: Material, folder: Path) -> None:
    bad = Material(folder / "steel.binary", folder)
    computed, failures = compute([bad, material], lambda one: {"size": np.array(one.measurement.stored.size)}, folder)
    assert [one.name for one in computed] == ["plastic"]
    assert isinstance(failures[0], Failure)
    assert failures[0].file == bad.file


def test_several_processes_give_the_same_in_order(folder: Path) -> None:
    done: list[float] = []
    computed, _ = compute(find_materials(folder, folder), name_length, folder / "n", jobs=2, progress=done.append)
    assert [int(one["length"]) for one in computed] == [10, 11, 9, 5]
    assert os.getpid() not in {int(one["process"]) for one in computed}
    assert all(one["watched"] for one in computed)
    assert done == [1, 2, 3, 4]
    with pytest.raises(InvalidArgumentError, match="jobs, the number of processes, must be at least 1, not 0"):
        compute([], name_length, folder, jobs=0)


def die(material: Material) -> Numbers:
    """End the process that computes."""
    os._exit(1)


def test_a_process_that_dies_is_told(folder: Path) -> None:
    with pytest.raises(ChildProcessError, match="a process died; run the command again"):
        compute(find_materials(folder, folder)[:2], die, folder / "n", jobs=2)


def test_an_interrupted_run_goes_on(folder: Path) -> None:
    found, calls = find_materials(folder, folder), list[str]()

    def interrupted(material: Material) -> Numbers:
        calls.append(material.name)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return {}

    with pytest.raises(KeyboardInterrupt):
        compute(found, interrupted, folder / "n")
    compute(found, interrupted, folder / "n")
    assert calls == ["merl_brass", "merl_nickel", "rgl_satin", "rgl_satin", "steel"]


def test_a_kept_fit_is_taken(
    material: Material, quick_fits: dict[str, FitResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(module, "fit_quietly")
    assert material.fit(method="paper", n_lobes=3) == quick_fits["paper-3"]


def test_a_fit_of_other_options_is_made_again(
    material: Material,
    quick_fits: dict[str, FitResult],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fresh = Material(material.file, tmp_path)
    save(quick_fits["paper-2"], tmp_path / "plastic.paper-1.json")
    monkeypatch.setattr(module, "fit_quietly", lambda *_: quick_fits["paper-1"])
    assert fresh.fit(method="paper", n_lobes=1) == quick_fits["paper-1"]
    monkeypatch.delattr(module, "fit_quietly")
    assert fresh.fit(method="paper", n_lobes=1) == quick_fits["paper-1"]
