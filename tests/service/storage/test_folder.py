"""The data folder: a folder with anything else in it is refused and left as it is."""

import os
import sqlite3
import stat
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from service.__main__ import main
from service.storage.database import FILE_NAME, Database
from service.storage.store import Store
from tests.support.commands import run_main


def make_folder(path: Path) -> None:
    (path / "pymp-a").mkdir(parents=True)
    for name in ("pymp-a/thesis.tex", "upload-1"):  # as the service names what it removes from its own folders
        (path / name).write_text("mine")


def make_database(path: Path) -> None:
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("CREATE TABLE theirs (a INTEGER)")


def link_to(name: str) -> Callable[[Path], None]:
    return lambda path: path.symlink_to(path.parents[1] / "outside" / name)


MAKE: dict[str, Callable[[Path], object]] = {
    "nothing": lambda path: path.touch(),
    "a byte": lambda path: path.write_bytes(b"S"),
    "a file": lambda path: path.write_bytes(b"no database" * 500),
    "a database": make_database,
    "a folder": make_folder,
    "a link to a file": link_to("upload-1"),
    "a link to a folder": link_to("pymp-a"),
    "a link to nothing": link_to("nothing"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that does not exist, beside one that symbolic links lead to."""
    monkeypatch.setattr("service.__main__._run", lambda *_: 0)  # it must not come to that
    make_folder(tmp_path / "outside")
    return tmp_path / "data"


def snapshot(folder: Path) -> dict[str, tuple[int, int, object]]:
    """Everything below a folder: what it is, when it was changed and what is in it."""
    found: dict[str, tuple[int, int, object]] = {}
    for path in sorted(folder.rglob("*")):
        content = path.readlink() if path.is_symlink() else path.read_bytes() if path.is_file() else None
        status = path.lstat()
        found[str(path.relative_to(folder))] = (stat.S_IFMT(status.st_mode), status.st_mtime_ns, content)
    return found


@pytest.mark.parametrize("kind", MAKE)
@pytest.mark.parametrize("names", [[FILE_NAME, "a letter"], [FILE_NAME, "blobs"], [f"{FILE_NAME}-wal"], ["tmp", "run"]])
def test_folder_that_is_not_the_services_is_refused_and_left_as_it_is(
    folder: Path, kind: str, names: list[str]
) -> None:
    folder.mkdir()
    for name in names:
        MAKE[kind](folder / name)
    before = snapshot(folder.parent)
    refused = run_main(main, "--data-dir", str(folder), "--port", "0")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert ("another program's" in refused.stderr) is (kind == "a database" and FILE_NAME in names)
    assert snapshot(folder.parent) == before


@pytest.mark.parametrize("kind", ["a file", "a link to a folder", "a link to nothing"])
@pytest.mark.parametrize("name", ["run", "tmp", "blobs"])
def test_what_is_in_the_place_of_a_folder_is_named_and_left_as_it_is(folder: Path, kind: str, name: str) -> None:
    Database(folder).close()
    MAKE[kind](folder / name)
    before = {path: what for path, what in snapshot(folder.parent).items() if name in path or "outside" in path}
    refused = run_main(main, "--data-dir", str(folder), "--port", "0")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert f"{folder / name} is not a folder" in refused.stderr
    assert snapshot(folder.parent).items() >= before.items()


def test_folder_of_the_service_loses_nothing_that_others_have_put_there(folder: Path) -> None:
    Database(folder).close()
    for kind, make in MAKE.items():
        for place in (folder, folder / "blobs", folder / "tmp", folder / "run", folder / "work"):
            place.mkdir(exist_ok=True)
            make(place / kind)
    misplaced = folder / "blobs" / "00" / f"{'1' * 64}.binary"
    misplaced.parent.mkdir()
    misplaced.touch()
    before = {path: what for path, what in snapshot(folder.parent).items() if not stat.S_ISDIR(what[0])}
    before.pop(f"data/{FILE_NAME}")
    Store(folder).close()
    assert snapshot(folder.parent).items() >= before.items()


def test_folder_of_a_start_that_was_killed_is_taken(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).touch()
    Store(tmp_path).close()


def test_new_folder_and_the_database_in_any_are_for_their_user_alone(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        for folder, mode in ((tmp_path / "new", 0o700), (tmp_path / "others can read", 0o755)):
            if mode == 0o755:
                folder.mkdir()
            with closing(Store(folder)):
                modes = {stat.S_IMODE(path.stat().st_mode) for path in folder.glob(f"{FILE_NAME}*")}
            assert (stat.S_IMODE(folder.stat().st_mode), modes) == (mode, {0o600})
    finally:
        os.umask(before)
