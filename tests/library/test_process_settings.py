"""The library computes with one BLAS thread and leaves the number as it was."""

import os
import subprocess
import sys

from dsbrdf.process_settings import ONE_BLAS_THREAD

# In a process of its own: the number of threads is that of the environment when NumPy is imported.
SCRIPT = """
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


def test_one_blas_thread_while_something_is_computed_and_as_many_as_before_afterwards() -> None:
    environment = os.environ | dict.fromkeys(ONE_BLAS_THREAD, "2")
    found = subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True)
    assert found.stdout.split("\n")[:-1] == ["[2]", "[1]", "[1]", "[2]"]
