"""The memory that the C library keeps when it is freed, returned to the system; only glibc's does as asked here."""

import ctypes
from contextlib import suppress

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # glibc's names for them begin with M_


def return_freed_memory() -> None:
    """Let the C library return large buffers when they are freed.

    By default, glibc raises its threshold when large buffers are freed and then keeps them, so that the process grows
    as long as it works; a threshold that is set stays. It also gives nearly each thread a heap of its own, and memory
    that is free in one cannot be used by another; two are enough. Other C libraries have neither parameter.
    """
    with suppress(AttributeError, OSError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, 1 << 20)
        library.mallopt(_TRIM_THRESHOLD, 2 << 20)  # otherwise each large buffer is taken from the system anew
        library.mallopt(_ARENA_MAX, 2)


def trim() -> None:
    """Return what is free between small buffers, which the C library keeps for ever; takes some milliseconds."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
