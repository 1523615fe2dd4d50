"""Look the pinned dependencies up among the known vulnerabilities, and say plainly what could not be looked up.

Exits with 1 if a dependency is vulnerable. What the vulnerability service does not answer for is no pass: it is
counted on stderr, but does not fail, because it says something of the network and nothing of the dependencies.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

TOP = Path(__file__).parent.parent
LOCKS = [TOP / lock for lock in (".ci/installer.lock", "requirements.lock", "docs/requirements.lock")]
TIMEOUT_S = 180
COMMAND = [
    *(word for lock in LOCKS for word in ("-r", str(lock))),
    "--disable-pip",
    "--require-hashes",
    "--format",
    "json",
    "--progress-spinner",
    "off",
]


def main() -> int:
    """Audit the lock file and return the exit code."""
    packages, reason = audit()
    skipped = [package for package in packages if "skip_reason" in package]
    vulnerable = [package for package in packages if package.get("vulns")]
    for package in vulnerable:
        for fault in package["vulns"]:
            fixed = ", ".join(fault["fix_versions"]) or "no version yet"
            sys.stdout.write(f"{package['name']} {package['version']}: {fault['id']}, mended in {fixed}\n")
    sys.stdout.write(f"{len(packages) - len(skipped)} dependencies audited, {len(vulnerable)} of them vulnerable\n")
    if reason:
        sys.stderr.write(f"NOT AUDITED: any dependency: {reason}\n")
    elif skipped:
        names = ", ".join(package["name"] for package in skipped)
        sys.stderr.write(f"NOT AUDITED: {len(skipped)} of {len(packages)} dependencies: {names}\n")
        sys.stderr.write(f"The first reason: {skipped[0]['skip_reason']}\n")
    return 1 if vulnerable else 0


def audit() -> tuple[list[dict[str, Any]], str]:
    """Return what pip-audit says of each dependency, or why it says nothing."""
    command = [str(Path(sys.executable).parent / "pip-audit"), *COMMAND]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S)  # noqa: S603 (fixed command)
    except subprocess.TimeoutExpired:
        return [], f"pip-audit has not finished within {TIMEOUT_S} s."
    try:
        found: list[dict[str, Any]] = json.loads(done.stdout)["dependencies"]
    except ValueError:
        return [], (done.stderr.strip().splitlines() or ["pip-audit said nothing."])[-1]
    return found, ""


if __name__ == "__main__":
    sys.exit(main())
