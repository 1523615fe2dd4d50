"""Run one benchmark with its options, several by name, or all the short ones: ``python -m benchmarks [name ...]``."""

import os
import subprocess
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from dsbrdf.process_settings import ONE_BLAS_THREAD

MAIN = "def main("
"""Modules of this package that contain this text are benchmarks; the others are helpers."""
BY_NAME_ONLY = ("atlas", "durability", "faults", "installation", "soak")
"""Benchmarks that take half an hour, install all packages or write into the package; they are run by name only."""


def known() -> list[str]:
    """Names of the benchmarks, in alphabetical order."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    return [path.stem for path in files if path.stem != "__main__" and MAIN in path.read_text()]


def main(arguments: Sequence[str]) -> int:
    """Run the requested benchmarks; return the exit code of the first one that fails, or 0."""
    options = next((i for i, word in enumerate(arguments) if word.startswith("-")), len(arguments))
    names, flags = list(arguments[:options]), list(arguments[options:])
    unknown = [name for name in names if name not in known()]
    if unknown or (flags and len(names) != 1):
        what = (
            f"no benchmark is called {unknown[0]}" if unknown else "options need the name of one benchmark before them"
        )
        print(f"{what}; the benchmarks are: {', '.join(known())}", file=sys.stderr)
        return 2
    if len(names) == 1:
        os.environ.update(ONE_BLAS_THREAD)  # The benchmark is the first to import NumPy.
        code: int = import_module(f"benchmarks.{names[0]}").main(flags)
        return code
    codes = []
    for name in names or [name for name in known() if name not in BY_NAME_ONLY]:
        print(f"== {name}", flush=True)
        codes.append(subprocess.run([sys.executable, "-m", "benchmarks", name], check=False).returncode)
    return next((code for code in codes if code), 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
