import json
import runpy
import subprocess
from pathlib import Path
from typing import Any

import pytest

FINE: dict[str, Any] = {"name": "numpy", "version": "2.4.0", "vulns": []}
VULNERABLE: dict[str, Any] = {
    "name": "starlette",
    "version": "0.1.0",
    "vulns": [{"id": "CVE-2099-1", "fix_versions": ["0.2.0"]}, {"id": "CVE-2099-2", "fix_versions": []}],
}
SKIPPED: dict[str, Any] = {"name": "scipy", "skip_reason": "Dependency not found: scipy (1.17.0)"}


@pytest.mark.parametrize(
    ("packages", "code", "out", "err"),
    [
        ([FINE], 0, "1 dependencies audited, 0 of them", ""),
        ([FINE, VULNERABLE], 1, "starlette 0.1.0: CVE-2099-1, mended in 0.2.0\n", ""),
        ([SKIPPED, VULNERABLE], 1, "CVE-2099-2, mended in no version yet\n", "NOT AUDITED: 1 of 2"),
        ([FINE, SKIPPED], 0, "1 dependencies audited", "NOT AUDITED: 1 of 2 dependencies: scipy\n"),
        (None, 0, "0 dependencies audited", "NOT AUDITED: any dependency: ConnectionError: no route\n"),
    ],
)
def test_only_vulnerabilities_fail_and_all_gaps_are_reported(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    packages: list[object] | None,
    code: int,
    out: str,
    err: str,
) -> None:
    said = "" if packages is None else json.dumps({"dependencies": packages})
    done = subprocess.CompletedProcess([], 0, said, "Traceback\nConnectionError: no route\n")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    assert runpy.run_path(str(Path(__file__).parents[2] / ".ci/audit.py"))["main"]() == code
    written = capsys.readouterr()
    assert out in written.out
    assert err in written.err
    assert bool(written.err) == bool(err)
