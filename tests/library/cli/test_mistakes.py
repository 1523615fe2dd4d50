"""Typical mistakes, and the sentence that each gets."""

from pathlib import Path

import pytest

from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import save
from tests.support.command_line import Capture, exit_code, sentence

FILES = {
    "photo.png": b"\x89PNG\r\n\x1a\n" + bytes(100),
    "studio.exr": b"v/1\x01" + bytes(100),
    "paint.json": b'{"format": "another", "version": 1}',
    "nickel.binary": b"\x5a\0\0\0\x5a\0\0\0\xb4\0\0\0" + bytes(100),
    "photo.json": b"\x89PNG\r\n\x1a\n" + bytes(100),
}

MISTAKES = {
    "fti nickel.binary": "dsbrdf: there is no command 'fti'; did you mean fit?",
    "": "dsbrdf: name a command (see dsbrdf --help)",
    "fit": "dsbrdf fit: FILES is missing (see dsbrdf fit --help)",
    "fit nickel.binary --lobes 2": "dsbrdf fit: there is no option --lobes; did you mean --lobe or --n-lobes?",
    "fit nickel.binary --n-lobes two": "--n-lobes: must be a whole number or auto, not 'two'",
    "fit nickle.binary": "dsbrdf: nickle.binary: No such file or directory",
    "fit nickel.binary": "dsbrdf: nickel.binary: The data has only 112 bytes",
    "fit photo.png": "dsbrdf: photo.png: The data is a PNG image; a MERL measurement is a .binary file",
    "fit studio.exr": "dsbrdf: studio.exr: The data is an OpenEXR image; a MERL measurement is a .binary file",
    "fit paint.json": "dsbrdf: paint.json: The data is JSON, or another text; a MERL measurement is a .binary file",
    "fit nickel.binary --url localhost:8000": "must be an address such as http://127.0.0.1:8000, not 'localhost:8000'",
    "show nickel.binary": "nickel.binary: this command reads models, not measurements; fit it first with dsbrdf fit",
    "show photo.json": "dsbrdf: photo.json: the file is a PNG image; a stored model is a .json or .npz file",
    "show photo.png": "dsbrdf: photo.png: the file is a PNG image; a stored model is a .json or .npz file",
    "show paint.json": "dsbrdf: paint.json: The data is not a stored model: its format is not 'dsbrdf'",
    "eval paint.json --theta-half ten": "dsbrdf eval: --theta-half: must be a number, not 'ten'",
    "eval paint.json --thetahalf 10": "there is no option --thetahalf; did you mean --theta-half",
    "export paint.json --format gltf -o a.glb": "dsbrdf export: --format: must be json or npz or merl",
    "export paint.json -o a.glb": "dsbrdf: a.glb: the file must end in one of .json, .npz, .binary, .glsl,",
    "render paint.json": "dsbrdf render: --output is missing",
    "plot paint.json -o paint.jpg": "dsbrdf: paint.jpg: the figure's file must end in .png, .svg or .pdf",
    "compare paint.json": "dsbrdf compare: SECOND is missing",
    "compare photo.json photo.json -o a.jpg": "dsbrdf: a.jpg: the picture's file must end in .png",
    "completion tcsh": "dsbrdf completion: SHELL: must be bash or zsh or fish, not 'tcsh'",
    "show paint.json photo.json": "dsbrdf show: there is no place for photo.json",
    "render paint.json -o": "dsbrdf render: -o needs a value",
    "--jobs 2 fit nickel.binary": "dsbrdf: there is no option '--jobs' before the command",
    "--helpp": "dsbrdf: there is no option '--helpp' before the command; did you mean --help?",
    "fit nickel.binary --robust=maybe": "dsbrdf fit: --robust: must be yes or no, not 'maybe'",
    "fit nickel.binary --n-lobes 2 --n-lobes 3": "dsbrdf fit: --n-lobes is given more than once",
    "eval paint.json --theta-half=": "dsbrdf eval: --theta-half: must be a number, not ''",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that are not what their names or the commands say; tests must not change them."""
    path = tmp_path_factory.mktemp("mistakes")
    for name, content in FILES.items():
        (path / name).write_bytes(content)
    return path


@pytest.mark.parametrize(("command", "said"), MISTAKES.items(), ids=[words or "nothing" for words in MISTAKES])
def test_mistake_gets_one_sentence(
    command: str, said: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(folder)
    assert exit_code(command.split()) == 2
    assert said in sentence(capsys)
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)


def test_arguments_have_no_order(two_lobe_fit: FitResult, tmp_path: Path, capsys: Capture) -> None:
    model_file = tmp_path / "paint.json"
    save(two_lobe_fit, model_file)
    outputs = []
    for words in (
        f"eval {model_file} --theta-half 0 10 --theta-diff 30",
        f"eval --theta-half 0 10 --theta-diff 30 {model_file}",
        f"eval --theta-half 0 10 {model_file} --theta-diff 30",
        f"eval --theta-half 0 --theta-diff 30 {model_file} --theta-half=10",
    ):
        assert exit_code(words.split()) == 0
        outputs.append(capsys.readouterr().out)
    assert outputs[0].count("\n") == 3
    assert set(outputs) == {outputs[0]}
