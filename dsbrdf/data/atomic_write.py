"""Files that are written whole or not at all."""

import os
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

__all__ = ["write_atomically"]


def write_atomically(path: str | os.PathLike[str], parts: Iterable[bytes | memoryview]) -> None:
    """Write a file so that nobody ever sees a part of it.

    The parts go to a temporary file in the same folder, which then takes the place of ``path`` in one step.
    If anything fails, ``path`` is as it was and the temporary file is gone.

    Parameters
    ----------
    path : path-like
        Where to write; an existing file is replaced.
    parts : iterable of bytes-like
        The content, in order.

    Raises
    ------
    OSError
        If the folder does not exist or cannot be written to, or the disk is full.
    """
    target = Path(path)
    try:
        descriptor, temporary = tempfile.mkstemp(prefix=f".{target.name[:100]}.", suffix=".part", dir=target.parent)
    except OSError as error:
        error.filename = str(target)  # what was asked for
        raise
    try:
        with os.fdopen(descriptor, "wb") as file:
            for part in parts:
                file.write(part)
        Path(temporary).chmod(_default_mode())
        Path(temporary).replace(target)
    except BaseException:
        with suppress(FileNotFoundError):
            Path(temporary).unlink()
        raise


def _default_mode() -> int:
    """Permissions of an ordinary new file; the temporary one starts out private."""
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
