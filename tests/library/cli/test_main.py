"""The command ``dsbrdf``: how it starts, its help, and the sentence that each mistake gets."""

import os
import re
import subprocess
import sys
from io import BytesIO, TextIOWrapper
from pathlib import Path

import pytest

import dsbrdf
from dsbrdf import extras, save
from dsbrdf.cli import main as cli
from dsbrdf.cli.arguments import SERVICE_COMMANDS
from dsbrdf.cli.commands import command_names
from tests.support.command_line import printed, run, sentence
from tests.support.models import mixture, samples_table, scattered_samples


@pytest.mark.parametrize(
    ("command", "missing", "extra"),
    [
        ("serve", "fastapi", "service"),
        ("fit a.binary", "cyclopts", "cli"),
        ("--help", "cyclopts", "cli"),
        ("fit a.binary --url http://host", "httpx", "client"),
    ],
)
def test_missing_extra_is_named(command: str, missing: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == missing else name)
    assert f"pip install 'dsbrdf[{extra}]'" in sentence(*command.split(), code=1)


def test_internal_error_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dsbrdf.cli.commands.run_command", lambda _: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        cli.main(["show"])


def test_a_closed_output_is_no_fault() -> None:
    command = ["sh", "-c", 'exec "$0" -m dsbrdf.cli.main fit none.binary --json 1>&-', sys.executable]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ("Traceback" in done.stderr, done.returncode) == (False, 2)


def test_a_full_output_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    with Path("/dev/full").open("wb", 0) as disk:
        monkeypatch.setattr(sys, "stdout", TextIOWrapper(disk, write_through=True))
        assert cli.main(["--version"]) == 1
    assert capsys.readouterr().err == "dsbrdf: No space left on device\n"


@pytest.mark.parametrize("errors", ["strict", "surrogateescape"])
def test_characters_that_an_output_cannot_encode_are_escaped(errors: str, monkeypatch: pytest.MonkeyPatch) -> None:
    output = BytesIO()
    monkeypatch.setattr(sys, "stdout", TextIOWrapper(output, "ascii", errors))
    cli.main(["--version"])
    print("30\N{DEGREE SIGN}", flush=True)
    assert output.getvalue().endswith(b"30\\xb0\n")


def test_version_is_printed() -> None:
    assert printed("--version") == f"dsbrdf {dsbrdf.__version__}\n"


def test_fit_asks_for_one_blas_thread_before_numpy_is_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dsbrdf.cli.commands.run_command", lambda _: int(os.environ["OMP_NUM_THREADS"]))
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delitem(sys.modules, "numpy")
    run("fit", "none.binary", code=1)


def test_commands_that_compute_nothing_import_no_numpy() -> None:
    """NumPy and SciPy would take most of the time of such a command; the version needs no extra either."""
    program = """
import sys
from dsbrdf.cli.main import main
for words in ["--version"], ["--help"], ["keys", "--help"], ["purge", "--help"]:
    main(words)
    print(words, sorted({"numpy", "scipy", *["cyclopts", "rich"] * (words == ["--version"])} & {*sys.modules}))
"""
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert re.findall(r"^\['.*(\[.*\])$", answer.stdout, re.MULTILINE) == ["[]"] * 4


@pytest.mark.parametrize("command", command_names())
def test_help_is_plain_text_in_a_file(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for columns, widest in ((80, 80), (200, 100)):
        monkeypatch.setenv("COLUMNS", str(columns))
        out = printed(command, "--help")
        assert out.startswith(f"Usage: dsbrdf {command}")
        assert max(map(len, out.splitlines())) <= widest
        assert out.isascii()
        assert not re.search(r"\x1b|\[default: False\]", out)


def test_help_lists_all_commands_in_groups() -> None:
    lines = [line.strip() for line in printed("--help").splitlines()]
    assert {"Models", "Pictures", "Files", "Service", "Options"} <= {*lines}
    listed = {line.split()[0] for line in lines if line}
    assert listed >= {*command_names(), *SERVICE_COMMANDS, "--help", "--version"}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_options_and_files(shell: str, tmp_path: Path) -> None:
    text, script = printed("completion", shell), tmp_path / "completion.sh"
    assert all(word in text for word in ("compare", "serve", "n-lobes", "theta-half", "specular_spike"))
    if shell == "bash":
        script.write_text(text)
        ask = f"source '{script}'; COMP_WORDS=(dsbrdf comp); COMP_CWORD=1; _dsbrdf; echo ${{COMPREPLY[@]}}"
        answer = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True)
        assert answer.stdout.split() == ["completion", "compare"]


FILES = {
    "photo.png": b"\x89PNG\r\n\x1a\n" + bytes(100),
    "paint.json": b'{"format": "another", "version": 1}',
    "nickel.binary": b"\x5a\0\0\0\x5a\0\0\0\xb4\0\0\0" + bytes(100),
    "photo.json": b"\x89PNG\r\n\x1a\n" + bytes(100),
    "empty.json": b"",
    "cut.bsdf": b"tensor_file\0\x01\x00",
    "bad.exr": b"nothing",
}
POINT = "eval model.json --theta-half 1 --theta-diff 1"

MISTAKES = {
    "fti nickel.binary": "dsbrdf: there is no command 'fti'; did you mean fit?",
    "": "dsbrdf: name a command (see dsbrdf --help)",
    "--jobs 2 fit nickel.binary": "dsbrdf: there is no option '--jobs' before the command",
    "completion tcsh": "dsbrdf completion: SHELL: must be bash or zsh or fish, not 'tcsh'",
    # fit
    "fit": "dsbrdf fit: FILES is missing (see dsbrdf fit --help)",
    "fit nickel.binary --lobes 2": "dsbrdf fit: there is no option --lobes; did you mean --lobe or --n-lobes?",
    "fit nickel.binary --n-lobes two": "--n-lobes: must be a whole number or auto, not 'two'",
    "fit nickel.binary --n-lobes 2 --n-lobes 3": "dsbrdf fit: --n-lobes is given more than once",
    "fit nickel.binary --knots-deg 0,x": "--knots-deg: must be",
    "fit nickel.binary --robust=maybe": "dsbrdf fit: --robust: must be yes or no, not 'maybe'",
    "fit nickel.binary --jobs 0": "--jobs: must be at least 1, not 0",
    "fit nickel.binary --scheduler host": "--scheduler: must be an address such as tcp://host:8786, not 'host'",
    "fit nickel.binary --url localhost:8000": "must be an address such as http://127.0.0.1:8000, not 'localhost:8000'",
    "fit nickle.binary": "dsbrdf: nickle.binary: No such file or directory",
    "fit nickel.binary": "dsbrdf: nickel.binary: The data has only 112 bytes",
    "fit photo.png": "dsbrdf: photo.png: The file is a PNG image; a picture has no directions of light and viewer",
    "fit plastic.binary -o plastic.json": "must be a folder, in which NAME.json is saved, not a file such as",
    "fit felt.csv --together a/b": "dsbrdf: --together: must be a name without a folder, not 'a/b'",
    "fit felt.csv --together=": "dsbrdf: --together: must be a name without a folder, not ''",
    "fit felt.csv plastic.binary --together a": "dsbrdf: plastic.binary: The file is a MERL file",
    # models
    "show nickel.binary": "nickel.binary: this command reads models, not measurements; fit it first with dsbrdf fit",
    "show photo.json": "dsbrdf: photo.json: the file is a PNG image; a stored model is a .json file",
    "show paint.json": "dsbrdf: paint.json: The data is not a stored model: its format is not 'dsbrdf'",
    "eval paint.json photo.json": "dsbrdf eval: there is no place for photo.json",
    "decompose empty.json": "dsbrdf: empty.json: ",
    "export model.json -o layers.txt --component layers": "the file must end in one of ",
    "export paint.json --format gltf -o a.glb": "dsbrdf export: --format: must be auto or ",
    "export model.json --format json -o none/model.json": "dsbrdf: none/model.json: No such file or directory\n",
    "export model.json --component diffuse -o diffuse.json": "the format json cannot contain a single component",
    "eval paint.json --thetahalf 10": "there is no option --thetahalf; did you mean --theta-half",
    "eval model.json": "--theta-half is missing",
    "eval model.json --theta-half 1 2 --theta-diff 1 2 3": "cannot be combined",
    "eval model.json --theta-half 1 --omega-in 0,0,1": "either --theta-half and --theta-diff, --theta-in and",
    "eval model.json --omega-in 0,1 --omega-out 0,0,1": "a direction must be three numbers x,y,z, not '0,1'",
    "table felt.csv --columns theta_in=angle": "The table has no column 'angle'; it has 'omega_in_x', 'omega_in_y', ",
    "table felt.csv --columns theta_inn=red": "The option columns has 'theta_inn'; the meanings are theta_in, phi_in, ",
    "table paint.csv --scale bright": "--scale: must be a number, not 'bright'",
    "table plastic.binary": "The file is a MERL file, a measurement on a grid, and no table of samples.",
    "convert paint.csv": "there is nothing to convert to paint.csv: name the measurement before it",
    "eval model.json --omega-in 0,0,1,0 --omega-out 0,0,1": "three numbers x,y,z, not '0,0,1,0'",
    f"{POINT} --component shiny": "--component: must be specular_spike or specular_lobe or diffuse or layers",
    f"{POINT} --component specular_spike": "dsbrdf: model.json: this model has no component specular_spike: it has ",
    # pictures
    "plot paint.json -o paint.jpg": "dsbrdf: paint.jpg: the figure's file must end in .png, .svg or .pdf",
    "compare paint.json": "dsbrdf: name a second file to compare with, or --with ggx",
    "compare photo.json photo.json -o a.jpg": "dsbrdf: a.jpg: the picture's file must end in .png",
    "render paint.json": "dsbrdf render: --output is missing",
    "render paint.json -o": "dsbrdf render: -o needs a value",
    "render plastic.binary -o a.png --exposure 0": "exposure must be a positive number",
    "render plastic.binary -o a.png --component diffuse": "a measurement has no components",
    "compare plastic.binary model.json -o a.png --component diffuse": "plastic.binary: a measurement has no components",
    "render plastic.binary model.json -o a.png": "there is no place for model.json",
    "render model.json -o a.png --lighting moon": "moon",
    "render model.json -o a.png --lighting bad.exr": "bad.exr: A panorama must be an OpenEXR picture; save it as .exr",
    "render model.json -o a.png --lighting room.hdr": "must be three_lights, environment or an .exr file",
    "compare felt.csv felt.csv": "fit it first",
    "render felt.csv -o a.png": "felt.csv: the file is a table of samples, not a measurement on a grid",
    # convert
    "convert plastic.binary out.png": "the output must end in .binary, .bsdf or .csv",
    "convert cut.bsdf out.binary": "cut.bsdf: The tensor file is damaged or cut off",
}


@pytest.fixture(scope="module")
def folder(plastic_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Good files, and such that are not what their names or the commands say; tests must not change them."""
    path = tmp_path_factory.mktemp("mistakes")
    for name, content in FILES.items():
        (path / name).write_bytes(content)
    os.link(plastic_file, path / "plastic.binary")
    save(mixture(2, 0), path / "model.json")
    (path / "felt.csv").write_bytes(samples_table(scattered_samples(mixture(1, 0), 300)))
    return path


@pytest.mark.parametrize(("command", "said"), MISTAKES.items(), ids=[words or "nothing" for words in MISTAKES])
def test_mistake_gets_one_sentence(command: str, said: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert said in sentence(*command.split())
    assert {path.name for path in folder.iterdir()} == {*FILES, "plastic.binary", "model.json", "felt.csv"}


def test_an_empty_argument_is_no_folder() -> None:
    assert "dsbrdf: an argument is empty, as of a variable without a value" in sentence("fit", "")


def test_options_with_several_values_may_be_repeated(folder: Path) -> None:
    felt, together = str(folder / "felt.csv"), "green=red,red=green"
    repeated = [word for pair in together.split(",") for word in ("--columns", pair)]
    assert printed("table", felt, *repeated) == printed("table", felt, "--columns", together)


def test_arguments_have_no_order(folder: Path) -> None:
    file, halves, diff = str(folder / "model.json"), "--theta-half 0 10", "--theta-diff 30"
    orders = [(file, halves, diff), (halves, diff, file), (halves, file, diff)]
    orders.append(("--theta-half 0", diff, f"{file} --theta-half=10"))
    (text,) = {printed("eval", *" ".join(words).split()) for words in orders}
    assert text.count("\n") == 3
