"""Finding materials, keeping what is computed of them, and computing several at once."""

import os
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper import materials as module
from benchmarks.paper.materials import Failure, Material, Numbers, choose, compute, find_materials
from dsbrdf import FitResult, InvalidArgumentError

_calls: list[str] = []


def name_length(material: Material) -> Numbers:
    """Numbers that take no time."""
    _calls.append(material.name)
    return {"length": np.array(len(material.name)), "process": np.array(os.getpid())}


def number_of_values(material: Material) -> Numbers:
    return {"size": np.array(material.measurement.stored.size)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("merl_brass", "merl_nickel", "rgl_satin", "steel"):
        (tmp_path / f"{name}.binary").touch()
    return tmp_path


def test_materials_are_found_by_their_names_and_stand_ins_known_by_theirs(folder: Path, tmp_path: Path) -> None:
    found = find_materials(folder, folder / "kept")
    names = {"merl_brass": False, "merl_nickel": False, "rgl_satin": True, "steel": True}
    assert {one.name: one.measured for one in found} == names
    assert [one.measured for one in find_materials(folder, folder, stand_ins="rgl_*")] == [True, True, False, True]
    # With or without their data base.
    assert [one.name for one in find_materials(folder, folder, names=["nickel", "steel"])] == ["merl_nickel", "steel"]
    with pytest.raises(InvalidArgumentError, match="contains no material gold"):
        find_materials(folder, folder, names=["gold"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidArgumentError, match=r"contains no \.binary file"):
        find_materials(tmp_path / "empty", tmp_path)


def test_preferred_materials_come_first_and_others_fill_up(folder: Path) -> None:
    found = find_materials(folder, folder)
    assert [one.name for one in choose(found, ("steel", "gold", "nickel"), 2)] == ["steel", "merl_nickel"]
    assert [one.name for one in choose(found, ("nickel",), 3)] == ["merl_nickel", "merl_brass", "steel"]
    assert len(choose(found, (), 9)) == 4


def test_numbers_are_kept_until_something_changes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, kept = find_materials(folder, folder)[:2], folder / "numbers"
    _calls.clear()
    first, failures = compute(found, name_length, kept)
    assert failures == []
    assert [one.name for one in first] == _calls == ["merl_brass", "merl_nickel"]
    again, _ = compute(found, name_length, kept)
    assert [int(one["length"]) for one in again] == [10, 11]
    assert len(_calls) == 2
    compute(found, name_length, kept, settings="others")
    assert len(_calls) == 4
    os.utime(found[1].file, (2e9, 2e9))
    compute(found, name_length, kept, settings="others")
    assert _calls[4:] == ["merl_nickel"]
    monkeypatch.setattr(module, "ALGORITHM_VERSION", "another")
    compute(found, name_length, kept, settings="others")
    assert len(_calls) == 7


def test_a_bad_file_does_not_stop_the_others(material: Material, folder: Path) -> None:
    bad = Material(folder / "steel.binary", folder)
    computed, failures = compute([bad, material], number_of_values, folder / "n")
    assert [(one.name, int(one["size"])) for one in computed] == [("plastic", 3 * 90 * 90 * 180)]
    assert isinstance(failures[0], Failure)
    assert failures[0].file == bad.file


def test_several_processes_give_the_same_in_order(folder: Path) -> None:
    done: list[float] = []
    computed, _ = compute(find_materials(folder, folder), name_length, folder / "n", jobs=2, progress=done.append)
    assert [int(one["length"]) for one in computed] == [10, 11, 9, 5]
    assert os.getpid() not in {int(one["process"]) for one in computed}
    assert done == [1, 2, 3, 4]
    with pytest.raises(InvalidArgumentError, match="jobs, the number of processes, must be at least 1, not 0"):
        compute([], name_length, folder, jobs=0)


def test_a_fit_is_made_once_for_a_file_and_options(
    material: Material, quick_fits: dict[str, FitResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = Material(material.file, tmp_path)
    monkeypatch.setattr(module, "fit_quietly", lambda *_: quick_fits["paper-1"])
    assert fresh.fit(method="paper", n_lobes=1) == quick_fits["paper-1"]
    monkeypatch.setattr(module, "fit_quietly", lambda *_: quick_fits["paper-2"])
    assert fresh.fit(method="paper", n_lobes=1) == quick_fits["paper-1"]
    assert fresh.fit(method="paper", n_lobes=2) == quick_fits["paper-2"]
