"""Print the part of requirements.lock that is needed for some purposes, to be installed with ``--require-hashes``.

``needs.py dependencies EXTRA...`` for the package with these extras, ``needs.py build-system`` for what builds it. Run
it beside pyproject.toml, which says what each needs; the comments of the lock say which packages those need in turn.
"""

import re
import sys
import tomllib
from pathlib import Path
from typing import Any


def needed(purposes: list[str], pyproject: dict[str, Any], lock: str) -> str:
    """Return the entries of `lock`, versions and hashes, that `purposes` need."""
    project = pyproject["project"]
    known = {
        "build-system": pyproject["build-system"]["requires"],
        "dependencies": project["dependencies"],
        **project["optional-dependencies"],
    }
    names = {re.split(r"[^\w-]", need)[0] for purpose in purposes for need in known[purpose]}
    entries = re.split(r"^(?=\w)", lock, flags=re.MULTILINE)
    while more := {_name(entry) for entry in entries if _needers(entry) & names} - names:
        names |= more
    return "".join(entry for entry in entries if _name(entry) in names)


def _name(entry: str) -> str:
    return entry.partition("==")[0]


def _needers(entry: str) -> set[str]:
    return set(re.findall(r"^    # +(?:via )?(\S+)", entry, re.MULTILINE))


if __name__ == "__main__":
    pyproject = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))
    print(needed(sys.argv[1:], pyproject, Path("requirements.lock").read_text(encoding="utf-8")), end="")
