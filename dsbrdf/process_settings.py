"""Settings of a process: cores, threads of BLAS, whether freed memory is kept for reuse, and when the process ends."""

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
"""Environment variables that limit BLAS to one thread; they count when NumPy is imported, not later.

The matrices of a fit are so small that several threads are slower than one, on a busy machine up to ten times.
`one_blas_thread` does the same in a process that has NumPy already.
"""
_blas_lock = threading.Lock()
# First the limiter, which remembers the number of threads before it, then an entry for each running computation.
_blas_limits: list[Any] = []

# The BLAS libraries of NumPy and SciPy reserve 64 MB together.
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
                _blas_limits.append(_blas().limit(limits=1, user_api="blas"))
            _blas_limits.append(None)
        try:
            return compute(*args, **kwargs)
        finally:
            with _blas_lock:
                _blas_limits.pop()
                if len(_blas_limits) == 1:
                    _blas_limits.pop().restore_original_limits()

    return limited


@cache
def _blas() -> Any:
    # Imported at the first computation, so that commands start at once.
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def end_with_parent() -> None:
    """Kill this process as soon as its parent has ended, however that happened.

    Raises MemoryError if there is not enough memory for the thread that watches.
    """
    from multiprocessing import connection, parent_process

    parent = parent_process()
    if parent is None:
        return
    sentinel, begun = parent.sentinel, threading.Lock()
    begun.acquire()

    def watch() -> None:
        begun.release()
        connection.wait([sentinel])
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))

    # `Thread.start` would wait for ever for a thread that has no memory to begin.
    _thread.start_new_thread(watch, ())
    if not begun.acquire(timeout=_THREAD_START_TIMEOUT_S):
        raise MemoryError("the thread that watches the parent process could not begin")


@one_blas_thread
def reserve_blas_memory() -> None:
    """Let the BLAS libraries of NumPy and SciPy take their working memory now, before a limit is set.

    OpenBLAS allocates this memory with the first operation that needs it, keeps it, and waits for ever if there is
    none.

    Raises MemoryError if a limit that is set already leaves too little.
    """
    import numpy as np
    from scipy.linalg import lapack

    try:
        mmap.mmap(-1, _BLAS_MEMORY_BYTES).close()
    except OSError:
        raise MemoryError("there is too little memory for BLAS") from None
    matrix = np.eye(256)
    matrix @ matrix
    lapack.dpotrf(matrix)


def keep_freed_memory() -> None:
    """Let the C library keep freed memory for the next request: a fit needs arrays of the same sizes again and again.

    By default, glibc returns large buffers to the system, and every page of a new one costs a page fault: a tenth of
    the time of a fit. Other C libraries have no such setting.
    """
    _mallopt({_MMAP_THRESHOLD: 1 << 25, _TRIM_THRESHOLD: 1 << 30})


def return_freed_memory() -> None:
    """Let the C library return large buffers when they are freed.

    By default, glibc raises its threshold when large buffers are freed and then keeps them, so that the process grows
    as long as it works; a threshold that is set stays. It also gives nearly each thread a heap of its own, and memory
    that is free in one cannot be used by another; two are enough. Other C libraries have neither parameter.
    """
    # Without a trim threshold, the C library would ask the system anew for each large buffer.
    _mallopt({_MMAP_THRESHOLD: 1 << 20, _TRIM_THRESHOLD: 2 << 20, _ARENA_MAX: 2})


def _mallopt(settings: dict[int, int]) -> None:
    with suppress(AttributeError, OSError, TypeError):
        library = ctypes.CDLL(None)
        for parameter, value in settings.items():
            library.mallopt(parameter, value)


def trim_memory() -> None:
    """Return free memory between small buffers, which the C library would keep, to the system; takes milliseconds."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
