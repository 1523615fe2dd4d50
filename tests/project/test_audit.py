"""What the audit of the dependencies says, and when it fails."""

import importlib.util
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[2] / ".ci" / "audit.py"
FINE: dict[str, Any] = {"name": "numpy", "version": "2.4.0", "vulns": []}
VULNERABLE: dict[str, Any] = {
    "name": "starlette",
    "version": "0.1.0",
    "vulns": [{"id": "CVE-2099-1", "fix_versions": ["0.2.0"]}, {"id": "CVE-2099-2", "fix_versions": []}],
}
SKIPPED: dict[str, Any] = {"name": "scipy", "skip_reason": "Dependency not found: scipy (1.17.0)"}


@pytest.fixture
def audit() -> ModuleType:
    spec = importlib.util.spec_from_file_location("audit", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("packages", "reason", "code", "out", "err"),
    [
        ([FINE], "", 0, "1 dependencies audited, 0 of them", ""),
        ([FINE, VULNERABLE], "", 1, "starlette 0.1.0: CVE-2099-1, mended in 0.2.0\n", ""),
        ([SKIPPED, VULNERABLE], "", 1, "CVE-2099-2, mended in no version yet\n", "NOT AUDITED: 1 of 2"),
        ([FINE, SKIPPED], "", 0, "1 dependencies audited", "NOT AUDITED: 1 of 2 dependencies: scipy\n"),
        ([], "no network", 0, "0 dependencies audited", "NOT AUDITED: any dependency: no network\n"),
    ],
)
def test_only_vulnerabilities_fail_and_all_gaps_are_reported(
    audit: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    packages: list[dict[str, Any]],
    reason: str,
    code: int,
    out: str,
    err: str,
) -> None:
    monkeypatch.setattr(audit, "audit", lambda: (packages, reason))
    assert audit.main() == code
    written = capsys.readouterr()
    assert out in written.out
    assert err in written.err
    assert bool(written.err) == bool(err)


@pytest.mark.parametrize(
    ("stdout", "stderr", "packages", "reason"),
    [
        ('{"dependencies": [{"name": "numpy"}]}', "Found nothing", [{"name": "numpy"}], ""),
        ("", "Traceback\nConnectionError: no route\n", [], "ConnectionError: no route"),
        ("", "", [], "pip-audit said nothing."),
    ],
)
def test_output_of_pip_audit_is_parsed(
    audit: ModuleType, monkeypatch: pytest.MonkeyPatch, stdout: str, stderr: str, packages: list[object], reason: str
) -> None:
    done = subprocess.CompletedProcess([], 0, stdout, stderr)
    monkeypatch.setattr(audit.subprocess, "run", lambda *_, **__: done)
    assert audit.audit() == (packages, reason)
