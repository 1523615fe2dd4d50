"""The data folder: a folder with anything else in it is refused and left as it is."""

import os
import shutil
import sqlite3
import stat
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from random import Random

import pytest

from service.__main__ import main
from service.errors import DataFolderError
from service.storage.database import FILE_NAME, Database
from service.storage.store import Store
from tests.support.commands import run_main
from tests.support.guarded import keys_command
from tests.support.server import Server

NAMES = ("run", "tmp", "lock", "blobs", "work", f"{FILE_NAME}-wal", FILE_NAME)
FOLDERS = 60


def snapshot(folder: Path) -> dict[str, object]:
    """Everything below a folder: what it is, when it was changed and what is in it."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        content: object = None
        if path.is_symlink():
            content = path.readlink()
        elif path.is_file():
            content = path.read_bytes()
        found[str(path.relative_to(folder))] = (stat.S_IFMT(status.st_mode), status.st_mtime_ns, content)
    return found


def fill(folder: Path, random: Random, names: tuple[str, ...]) -> None:
    """Make files, folders and symbolic links, some of them with the names that the service uses."""
    outside = folder.parent / "outside"
    for name in random.sample(names, random.randint(1, len(names))):
        path = folder / name
        match random.randrange(4):
            case 0:
                path.write_bytes(random.randbytes(random.choice((1, 100, 5000))))
            case 1:
                path.mkdir()
                for inner in random.sample(("upload-1", "pymp-a", "00", "notes.txt"), 2):
                    (path / inner).write_text("mine")
            case 2:
                path.symlink_to(outside / random.choice(("file", "folder", "nothing")))
            case _:
                (path / "pymp-a").mkdir(parents=True)
                (path / "pymp-a" / "thesis.tex").write_text("mine")


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A file and a folder that symbolic links lead to."""
    folder = tmp_path / "outside"
    (folder / "folder").mkdir(parents=True)
    for name in ("file", "folder/upload-1", "folder/notes.txt"):
        (folder / name).write_text("mine")
    return folder


def test_random_folders_are_refused_and_left_as_they_are(tmp_path: Path, outside: Path) -> None:
    random = Random(10)
    for number in range(FOLDERS):
        folder = tmp_path / f"given{number}"
        folder.mkdir()
        fill(folder, random, NAMES)
        before = snapshot(tmp_path)
        refused = run_main(main, "--data-dir", str(folder), "--port", "0")
        assert refused.returncode == 2, refused.stderr
        assert refused.stderr.count("\n") == 1
        assert snapshot(tmp_path) == before, number
        shutil.rmtree(folder)  # else every snapshot would read all folders so far


def test_folder_of_the_service_loses_nothing_that_others_have_put_there(tmp_path: Path, outside: Path) -> None:
    random = Random(11)
    accepted = 0
    for number in range(40):
        folder = tmp_path / f"data{number}"
        Database(folder).close()
        fill(folder, random, tuple(name for name in NAMES if not name.startswith(FILE_NAME)))
        for name in ("run", "tmp", "blobs"):
            if (folder / name).is_dir() and not (folder / name).is_symlink():
                for inner in ("upload-1", "pymp-a"):  # names of temporary files: the service removes these
                    (folder / name / inner).rename(folder / f"{name}-{inner}") if (
                        folder / name / inner
                    ).exists() else 0
        before = {name: what for name, what in snapshot(tmp_path).items() if FILE_NAME not in name}
        try:
            Store(folder).close()
            accepted += 1
        except DataFolderError as error:
            assert "not a folder of the service's own" in str(error)  # noqa: PT017
        after = snapshot(tmp_path)
        same = {name: after.get(name) for name in before}
        folders = {name for name in before if stat.S_ISDIR(before[name][0])}  # type: ignore[index]
        assert {name: same[name] for name in same if name not in folders} == {
            name: before[name] for name in before if name not in folders
        }
        assert folders <= after.keys()
        shutil.rmtree(folder)
    assert 0 < accepted < 40


@pytest.mark.parametrize("name", ["run", "tmp", "blobs"])
def test_file_in_the_place_of_a_folder_is_named_in_one_sentence(tmp_path: Path, name: str) -> None:
    Database(tmp_path).close()
    (tmp_path / name).write_text("mine")
    refused = run_main(main, "--data-dir", str(tmp_path), "--port", "0")
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert f"{tmp_path / name} is not a folder" in refused.stderr
    assert (tmp_path / name).read_text() == "mine"


def test_database_of_another_program_is_refused(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / FILE_NAME)) as db, db:
        db.execute("CREATE TABLE theirs (a INTEGER)")
    before = snapshot(tmp_path)
    with pytest.raises(DataFolderError, match="another program"):
        Store(tmp_path)
    assert snapshot(tmp_path) == before


def test_folder_of_a_start_that_was_killed_is_taken(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).touch()
    Store(tmp_path).close()


def test_database_is_for_its_user_alone_in_a_folder_that_others_can_read(own_server: Callable[..., Server]) -> None:
    before = os.umask(0o022)
    try:
        server = own_server(fits=False)
    finally:
        os.umask(before)
    for path in server.data_dir.glob(f"{FILE_NAME}*"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_new_key_tells_that_its_data_folder_is_new(tmp_path: Path) -> None:
    folder = tmp_path / "wrong"
    first = keys_command("add", "x", "--data-dir", str(folder))
    assert first.returncode == 0
    assert f"{folder} becomes a new data folder" in first.stderr
    assert "new data folder" not in keys_command("add", "y", "--data-dir", str(folder)).stderr
    other = tmp_path / "home"
    other.mkdir()
    (other / "letter.txt").write_text("mine")
    refused = keys_command("add", "x", "--data-dir", str(other))
    assert refused.returncode == 2
    assert [path.name for path in other.iterdir()] == ["letter.txt"]
