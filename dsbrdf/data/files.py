"""Write files atomically, and recognise kinds of files by their first bytes."""

import os
from collections.abc import Iterable
from pathlib import Path
from secrets import token_hex


def write_atomically(path: str | os.PathLike[str], parts: Iterable[bytes | memoryview]) -> None:
    """Write the parts of a file atomically: other processes see the old file or the whole new file.

    The parts are written to a temporary file in the same folder, which then replaces `path`. After an error, `path` is
    unchanged and the temporary file is removed; an OSError names `path`.
    """
    target = Path(path)
    # Fifty characters of UTF-8 have at most 200 bytes, so that the temporary name stays below the limit of 255 bytes.
    temporary = target.parent / f".{target.name[:50]}.{token_hex(8)}.part"
    try:
        file = temporary.open("xb")
    except OSError as error:
        error.filename = str(target)  # The caller does not know the name of the temporary file.
        raise
    try:
        with file:
            for part in parts:
                file.write(part)
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


# First bytes of files that users may confuse with measurements, each with the kind that an error message names.
_KINDS = {
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"v/1\x01": "an OpenEXR image",
    b"#?": "a Radiance image",
    b"PK\x03\x04": "a ZIP archive or a NumPy .npz file",
    b"\x1f\x8b": "gzip, without the header Content-Encoding: gzip if it was sent over HTTP",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\x93NUMPY": "a .npy array",
    b"\x89HDF": "an HDF5 file",
    b"\x0e\x03\x13\x01": "an HDF4 file",
    b"CDF": "a netCDF file",
    b"MATLAB": "a MATLAB file",
    b"tensor_file\0": "an RGL .bsdf file, which dsbrdf convert turns into a MERL file",
    b"%PDF": "a PDF document",
    b"{": "JSON, or another text",
    b"<": "HTML or XML",
}


def known_kind(start: bytes) -> str | None:
    """Return the kind of a file from its first bytes, such as "a PNG image"; None if it is unknown."""
    return next((kind for magic, kind in _KINDS.items() if start.startswith(magic)), None)
