"""Whether a wheel and a source distribution work in empty environments: each Python, lowest and newest versions.

Each row is an environment of its own with what was built from this folder and the packages that its extras need. There
the command fits a synthetic measurement, shows and exports the fit and draws it, and a service answers a client's fit.
It needs the network, or an index of packages.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from dsbrdf import write_merl
from dsbrdf.data import synthetic_measurement
from dsbrdf.process_settings import ONE_BLAS_THREAD
from tests.support.processes import free_port

PROJECT = Path(__file__).parent.parent
EXTRAS = "cli,service,client,plot"
COMMANDS = (
    ("--version",),
    ("fit", "paint.binary", "--n-lobes", "2", "-o", "fits"),
    ("show", "fits/paint.json"),
    ("export", "fits/paint.json", "-o", "paint.glsl"),
    ("plot", "fits/paint.json", "-o", "paint.png"),
)
CLIENT = """
import sys, time
from dsbrdf import FitOptions
from dsbrdf_service.client import Client
for _ in range(100):
    try:
        with Client(sys.argv[1]) as client:
            client.fit("paint.binary", FitOptions(n_lobes=2)).model.evaluate(0.2, 0.5)
            break
    except Exception as error:
        last = error
        time.sleep(0.3)
else:
    raise last
"""


def main(argv: Sequence[str]) -> int:
    """Print a line for each environment; the exit code is 1 if one does not work."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks installation", description=__doc__)
    parser.add_argument("--pythons", nargs="+", default=[sys.executable], metavar="PYTHON", help="interpreters to try")
    pythons: list[str] = parser.parse_args(argv).pythons
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run(folder, sys.executable, "-m", "venv", "tools")
        run(folder, "tools/bin/pip", "install", "--quiet", "uv")
        run(PROJECT, sys.executable, "-m", "hatchling", "build", "--directory", str(folder / "dist"))
        write_merl(folder / "paint.binary", synthetic_measurement().values)
        print("| Python | from | versions | works | seconds |\n|---|---|---|---|---|")
        working = True
        for python in pythons:
            for kind, resolution in (("*.whl", "highest"), ("*.whl", "lowest-direct"), ("*.tar.gz", "highest")):
                begin = time.perf_counter()
                (package,) = (folder / "dist").glob(kind)
                version, fault = tried(folder, python, package, resolution)
                working = working and not fault
                cells = [version, package.name, resolution, fault or "yes", f"{time.perf_counter() - begin:.0f}"]
                print(f"| {' | '.join(cells)} |", flush=True)
    return 0 if working else 1


def tried(folder: Path, python: str, package: Path, resolution: str) -> tuple[str, str]:
    """The version of an interpreter, and what does not work in a new environment of it, or nothing."""
    version = run(folder, python, "-c", "import platform; print(platform.python_version())").strip()
    try:
        run(folder, "tools/bin/uv", "venv", "--quiet", "--clear", "--python", python, "new")
        install = ["pip", "install", "--quiet", "--python", "new/bin/python", "--resolution", resolution]
        run(folder, "tools/bin/uv", *install, f"{package}[{EXTRAS}]")
        for command in COMMANDS:
            run(folder, "new/bin/dsbrdf", *command)
        port = str(free_port())
        serve = ["new/bin/dsbrdf", "serve", "--port", port, "--data-dir", str(folder / f"data{port}")]
        with subprocess.Popen(serve, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as service:
            try:
                run(folder, "new/bin/python", "-c", CLIENT, f"http://127.0.0.1:{port}")
            finally:
                service.terminate()
    except subprocess.CalledProcessError as error:
        return version, (error.stderr.strip().splitlines() or [str(error)])[-1]
    return version, ""


def run(folder: Path, *command: str) -> str:
    """Run a command in a folder; return what it prints."""
    environment = os.environ | ONE_BLAS_THREAD | {"PYTHONWARNINGS": "error::DeprecationWarning:dsbrdf"}
    answer = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    return answer.stdout
