"""Configure a process: its cores, threads of BLAS and freed memory, and its end when the parent process ends."""

import _thread
import ctypes
import mmap
import os
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

_P = ParamSpec("_P")
_R = TypeVar("_R")

ONE_BLAS_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
"""Environment variables that limit BLAS to one thread, if they are set before NumPy is imported.

The matrices of a fit are so small that several threads are slower than one thread, on a busy machine up to ten times.
`one_blas_thread` limits BLAS after NumPy has been imported.
"""
_blas_lock = threading.Lock()
_blas_limits: list[Any] = []
"""The limiter, which stores the former number of threads, then an entry for each running computation.

The last computation to end restores the former number of threads.
"""

# The BLAS libraries of NumPy and of SciPy reserve 32 MB each; another 32 MB are a margin for small buffers.
_BLAS_MEMORY_BYTES = 96 << 20
_THREAD_START_TIMEOUT_S = 10.0

# Parameters of glibc's mallopt: M_TRIM_THRESHOLD, M_MMAP_THRESHOLD and M_ARENA_MAX.
_TRIM_THRESHOLD = -1
_MMAP_THRESHOLD = -3
_ARENA_MAX = -8


def core_count() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def one_blas_thread(compute: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorate a function to compute with one BLAS thread; the last concurrent call restores the former number."""

    @wraps(compute)
    def limited(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with _blas_lock:
            if not _blas_limits:
                _control_blas()
                _blas_limits.append(_blas().limit(limits=1, user_api="blas"))
            _blas_limits.append(None)
        try:
            return compute(*args, **kwargs)
        finally:
            with _blas_lock:
                _blas_limits.pop()
                if len(_blas_limits) == 1:
                    _control_blas()
                    _blas_limits.pop().restore_original_limits()

    return limited


def _control_blas() -> None:
    """Let this thread set the number of BLAS threads, which threadpoolctl allows only to the first one that does."""
    from threadpoolctl import OpenBLASController  # As slow as in `_blas`.

    OpenBLASController.clear_controlling_thread(force=True)


@cache
def _blas() -> Any:
    # This import is slow and therefore inside the function: commands that do not compute never need threadpoolctl.
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def end_with_parent() -> None:
    """Start a thread that kills this process as soon as its parent has ended, for whatever reason.

    Raises MemoryError if there is not enough memory for the thread.
    """
    from multiprocessing import connection, parent_process  # Only processes that are started need them.

    parent = parent_process()
    if parent is None:
        return
    sentinel, begun = parent.sentinel, threading.Lock()
    begun.acquire()

    def watch() -> None:
        begun.release()
        connection.wait([sentinel])
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))

    # `Thread.start` would wait for ever if the new thread has too little memory to begin; this lock has a timeout.
    _thread.start_new_thread(watch, ())
    if not begun.acquire(timeout=_THREAD_START_TIMEOUT_S):
        raise MemoryError("the thread that watches the parent process could not begin")


@one_blas_thread
def reserve_blas_memory() -> None:
    """Make the BLAS libraries of NumPy and SciPy allocate their working memory now, before a memory limit is set.

    OpenBLAS allocates this memory in the first operation that needs memory, and never frees it. If the memory cannot be
    allocated, OpenBLAS waits for ever.

    Raises MemoryError if an existing limit leaves too little memory.
    """
    import numpy as np  # The command line asks for one thread before NumPy is imported.
    from scipy.linalg import lapack

    try:
        mmap.mmap(-1, _BLAS_MEMORY_BYTES).close()
    except OSError:
        raise MemoryError("there is too little memory for BLAS") from None
    matrix = np.eye(256)
    matrix @ matrix
    lapack.dpotrf(matrix)


def keep_freed_memory() -> None:
    """Make the C library keep freed memory for reuse, because a fit allocates arrays of equal sizes many times.

    By default, glibc returns large buffers to the system, and every page of a new buffer causes a page fault. These
    page faults take a tenth of the time of a fit. With other C libraries than glibc, this function has no effect.
    """
    _mallopt({_MMAP_THRESHOLD: 1 << 25, _TRIM_THRESHOLD: 1 << 30})


def return_freed_memory() -> None:
    """Make the C library return large buffers to the system when they are freed.

    By default, glibc raises its threshold when large buffers are freed, and then keeps them, so that a long-running
    process grows. A threshold that this function sets stays fixed. By default, glibc also gives almost every thread
    its own heap, whose free memory other threads cannot use; two heaps are enough. With other C libraries than glibc,
    this function has no effect.
    """
    # Without a trim threshold, the C library would request memory from the system for each large buffer.
    _mallopt({_MMAP_THRESHOLD: 1 << 20, _TRIM_THRESHOLD: 2 << 20, _ARENA_MAX: 2})


def _mallopt(settings: dict[int, int]) -> None:
    with suppress(AttributeError, OSError, TypeError):
        library = ctypes.CDLL(None)
        for parameter, value in settings.items():
            library.mallopt(parameter, value)


def trim_memory() -> None:
    """Return free memory between small buffers, which the C library would keep, to the system within milliseconds."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
