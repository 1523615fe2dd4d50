"""Settings: each is described, and a wrong one is refused in one sentence that names it."""

import os
import pty
import re
import socket
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from pydantic import ValidationError

from dsbrdf_service.admin.serve import main
from dsbrdf_service.settings import Settings
from tests.support.commands import start_in_vain


def test_failed_start_is_reported_in_one_sentence(tmp_path: Path) -> None:
    file, folder = tmp_path / "file", str(tmp_path / "data")
    file.touch()
    no_folder = f"{file} is not a folder; give a data folder that is new, empty or the service's"
    assert start_in_vain(tmp_path, "--data-dir", str(file)) == (2, f"dsbrdf: {no_folder}\n")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        in_use = f"port {port} of 127.0.0.1 cannot be listened on: Address already in use."
        assert start_in_vain(tmp_path, "--data-dir", folder, "--port", str(port)) == (1, f"dsbrdf: {in_use}\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--prot", "3"], "dsbrdf serve: there is no option --prot; did you mean --port"),
        (["--port"], "dsbrdf serve: --port needs a value"),
        (["--port", "eighty"], "dsbrdf: --port must be a whole number, not 'eighty'.\n"),
        (["--port", "99999"], "dsbrdf: --port must be at most 65535, not '99999'.\n"),
        (["8000"], "dsbrdf serve: there is no place for 8000"),
    ],
)
def test_wrong_flag_is_named_in_one_sentence(capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert main(words) == 2
    sentence = capsys.readouterr().err
    assert sentence.startswith(said)
    assert sentence.count("\n") == 1


def test_number_with_too_many_digits_is_refused_for_each_setting() -> None:
    numbers = [name for name, field in Settings.model_fields.items() if field.annotation is int]
    assert len(numbers) == 11
    for name in numbers:
        with pytest.raises(ValidationError, match=f"{name}\n  Input should be less than "):
            Settings.model_validate({name: "9" * 400})


def test_address_is_told_at_a_terminal(tmp_path: Path) -> None:
    leader, follower = pty.openpty()
    run = [sys.executable, "-m", "dsbrdf.cli.main", "serve", "--port", "0", "--data-dir", str(tmp_path / "data")]
    with subprocess.Popen(run, stdout=follower, stderr=subprocess.DEVNULL) as process, os.fdopen(leader) as told:
        try:
            os.close(follower)
            address = re.search(r"dsbrdf serves at (http://127\.0\.0\.1:\d+); Ctrl-C stops it\.", told.readline())
            assert address
            assert httpx.get(f"{address[1]}/health/live").status_code == 200
        finally:
            process.terminate()
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("DSBRDF_PORT", "eighty"),
        ("DSBRDF_LOG_LEVEL", "loud"),
        ("DSBRDF_WORKERS", "0"),
        ("DSBRDF_FIT_MEMORY_MB", "767"),
        ("DSBRDF_SHUTDOWN_SECONDS", "99999999999999999999"),
        ("DSBRDF_IDLE_TIMEOUT", "-1"),
        ("DSBRDF_INSECURE", "perhaps"),
    ],
)
def test_invalid_setting_is_named_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, value: str
) -> None:
    monkeypatch.setenv(name, value)
    assert main(["--data-dir", str(tmp_path / "data")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"dsbrdf: {name} must be ")
    assert repr(value) in said
    assert said.count("\n") == 1
    assert not (tmp_path / "data").exists()


def test_empty_environment_variable_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in Settings.model_fields:
        monkeypatch.setenv(f"DSBRDF_{name.upper()}", "")
    assert Settings() == Settings(_env_prefix="NOTHING_")  # type: ignore[call-arg]


def test_help_names_the_defaults(tmp_path: Path) -> None:
    code, text = start_in_vain(tmp_path, "--help")
    assert code == 0
    words = " ".join(text.split())
    assert "Default: one for each core." in words
    assert "Default: 127.0.0.1." in words
