"""Settings: each is described, and a wrong one is refused in one sentence that names it."""

import json
import socket
from pathlib import Path

import pytest

from service.__main__ import main
from service.settings import Settings, unknown_settings
from tests.support.commands import start_in_vain
from tests.support.server import Server


def test_failed_start_is_reported_in_one_sentence(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for words, code, sentence in (
            (
                ["--data-dir", str(file)],
                2,
                f"{file} is not a folder; give a data folder that is new, empty or the service's",
            ),
            (["--port", str(port)], 1, f"port {port} of 127.0.0.1 cannot be listened on: Address already in use."),
        ):
            arguments = ["--data-dir", str(tmp_path / "data"), *words]
            assert start_in_vain(tmp_path, *arguments) == (code, f"dsbrdf: {sentence}\n")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("DSBRDF_PORT", "eighty"),
        ("DSBRDF_LOG_LEVEL", "loud"),
        ("DSBRDF_WORKERS", "0"),
        ("DSBRDF_HEADER_TIMEOUT", "-1"),
        ("DSBRDF_ACCESS_LOG", "perhaps"),
    ],
)
def test_invalid_setting_is_named_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, value: str
) -> None:
    monkeypatch.setenv(name, value)
    assert main(["--data-dir", str(tmp_path / "data")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"dsbrdf: {name}: ")
    assert repr(value) in said
    assert said.count("\n") == 1
    assert not (tmp_path / "data").exists()


def test_unknown_environment_variable_is_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DSBRDF_WORKER", "2")
    monkeypatch.setenv("DSBRDF_KEY", "of-the-client")
    assert unknown_settings() == [
        "The environment variable DSBRDF_WORKER is no setting and has no effect; did you mean DSBRDF_WORKERS?"
    ]
    server = Server(tmp_path / "data")
    try:
        server.start()
        (told,) = [line for line in server.log.read_text().splitlines() if "DSBRDF_" in line]
        assert json.loads(told)["level"] == "warning"
    finally:
        server.close()


def test_empty_environment_variable_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in Settings.model_fields:
        monkeypatch.setenv(f"DSBRDF_{name.upper()}", "")
    assert Settings() == Settings(_env_prefix="NOTHING_")  # type: ignore[call-arg]


def test_every_setting_is_described() -> None:
    for name, field in Settings.model_fields.items():
        assert field.description, name
        assert field.description.endswith("."), name
    assert Settings().shutdown_seconds < 10
