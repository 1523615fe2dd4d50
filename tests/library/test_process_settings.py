"""The library computes with one BLAS thread and leaves the number as it was; BLAS has its memory before a limit is set.

Each in a process of its own: settings are those of the environment when NumPy is imported.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dsbrdf.process_settings import ONE_BLAS_THREAD

THREADS = """
import threading
import scipy.linalg
from threadpoolctl import threadpool_info
from dsbrdf.process_settings import one_blas_thread

def blas_threads():
    return sorted({pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"})

inside, both = threading.Event(), threading.Barrier(2)

@one_blas_thread
def compute(fails):
    both.wait()  # two computations at once: the first to end must not put the number back
    if fails:
        raise ValueError
    inside.wait()
    print(blas_threads())

one_blas_thread(blas_threads)()  # another thread than this one limits BLAS next
print(blas_threads())
other = threading.Thread(target=compute, args=(False,))
other.start()
try:
    compute(fails=True)
except ValueError:
    print(blas_threads())
inside.set()
other.join()
print(blas_threads())
"""

LIMITED = """
import resource
import numpy as np
from scipy.linalg import lapack
from dsbrdf.process_settings import one_blas_thread, reserve_blas_memory

reserve_blas_memory()
matrix = np.eye(300)
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + (8 << 20)  # OpenBLAS takes 32 MB at once
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

@one_blas_thread
def compute():
    return lapack.dpotrf(matrix @ matrix)[1]

print(compute())
"""


def test_one_blas_thread_while_something_is_computed_and_as_many_as_before_afterwards() -> None:
    environment = os.environ | dict.fromkeys(ONE_BLAS_THREAD, "2")
    command = [sys.executable, "-c", THREADS]
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60)
    assert found.stdout.split("\n")[:-1] == ["[2]", "[1]", "[1]", "[2]"]


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads the size of the process in /proc")
def test_blas_that_has_its_memory_computes_under_a_limit() -> None:
    command, environment = [sys.executable, "-c", LIMITED], os.environ | ONE_BLAS_THREAD
    found = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert found.stdout == "0\n", found.stderr
