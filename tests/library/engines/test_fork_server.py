"""The server from which worker processes are forked, in a program of its own with a folder of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork server")

PROGRAM = """
import tempfile, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from dsbrdf.engines.local import LocalEngine

make_folder = tempfile.mkdtemp

def make_folder_slowly(*arguments, **named):  # as on a slow disk
    time.sleep(0.1)
    return make_folder(*arguments, **named)

tempfile.mkdtemp = make_folder_slowly
engine, together = LocalEngine(1), Barrier(8)

def check(_):
    together.wait()
    engine.check()

with ThreadPoolExecutor(8) as pool:
    list(pool.map(check, range(8)))
print(len(list(Path(tempfile.gettempdir()).glob("pymp-*"))))
engine.check()
"""


@pytest.mark.slow
def test_threads_that_start_the_server_at_once_share_one_folder(tmp_path: Path) -> None:
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, "1", "")
