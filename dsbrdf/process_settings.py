"""Settings of a process that computes fits: processor cores, threads of BLAS, and memory that is kept for reuse."""

import ctypes
import os
from contextlib import suppress

ONE_BLAS_THREAD = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
}
"""Environment variables that limit BLAS to one thread; they count when NumPy is imported, not later.

The matrices of a fit are so small that several threads are slower than one, on a busy machine up to ten times.
"""

_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1  # glibc's M_MMAP_THRESHOLD and M_TRIM_THRESHOLD


def core_count() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def keep_freed_memory() -> None:
    """Let the C library keep freed memory for the next request: a fit needs arrays of the same sizes again and again.

    By default, glibc returns large buffers to the system, and every page of a new one costs a page fault: a tenth of
    the time of a fit. Other C libraries have no such setting.
    """
    with suppress(AttributeError, OSError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, 1 << 25)  # the largest value that every version accepts
        library.mallopt(_TRIM_THRESHOLD, 1 << 30)
