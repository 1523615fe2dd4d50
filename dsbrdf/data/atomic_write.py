"""Files that are written completely or not at all."""

import os
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path


def write_atomically(path: str | os.PathLike[str], parts: Iterable[bytes | memoryview]) -> None:
    """Write a file so that no other process ever sees an incomplete one.

    The parts are written to a temporary file in the same folder, which then replaces ``path`` in one step.
    After an error, ``path`` is unchanged and the temporary file is removed.

    Parameters
    ----------
    path : path-like
        The file to write; an existing one is replaced.
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
        error.filename = str(target)  # the name that the caller knows
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
    """Return the permissions of an ordinary new file; those of the temporary file are stricter."""
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
