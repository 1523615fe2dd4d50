"""The command ``dsbrdf``: how it starts, its help, and the sentence that each mistake gets."""

import os
import re
import shlex
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
from tests.support.reproduced import assert_reproduced


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
    "broken.py": b"1 / 0",
}
MISTAKES = ["", *(Path(__file__).parent / "mistakes.txt").read_text().splitlines()]


@pytest.fixture(scope="module")
def folder(plastic_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Good files, and such that are not what their names or the commands say; tests must not change them."""
    path = tmp_path_factory.mktemp("mistakes")
    for name, content in FILES.items():
        (path / name).write_bytes(content)
    for name in ("plastic.binary", "paint.binary"):
        os.link(plastic_file, path / name)
    for name in ("model.json", "felt.json"):
        save(mixture(2, 0), path / name)
    (path / "felt.csv").write_bytes(samples_table(scattered_samples(mixture(1, 0), 300)))
    return path


@pytest.mark.parametrize("command", MISTAKES)
def test_mistake_gets_one_sentence(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert_reproduced(f"mistakes/{command}", sentence(*shlex.split(command)))
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before


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
