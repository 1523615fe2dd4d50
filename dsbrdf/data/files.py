"""Write files atomically, and recognise kinds of files by their first bytes."""

import os
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from secrets import token_hex
from typing import NamedTuple


def write_atomically(path: str | os.PathLike[str], parts: Iterable[bytes | memoryview]) -> None:
    """Write the parts of a file atomically: other processes see the old file or the whole new file.

    The parts are written to a temporary file in the same folder, which then replaces `path`. After an error, `path` is
    unchanged and the temporary file is removed; an OSError names `path`.
    """
    target = Path(path)
    # Fifty characters of UTF-8 have at most 200 bytes, so that the temporary name stays below the limit of 255 bytes.
    temporary = target.parent / f".{target.name[:50]}.{token_hex(8)}.part"
    try:
        with temporary.open("xb") as file:
            for part in parts:
                file.write(part)
        temporary.replace(target)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            error.filename, error.filename2 = str(target), None  # The caller does not know the temporary file.
        raise


class FileKind(NamedTuple):
    """Name a kind of file that is no measurement, and say what to do with such a file."""

    name: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.name}; {self.remedy}"


_PICTURE = "a picture has no directions of light and viewer"
_UNPACK = "unpack it first"
_AS_TABLE = (
    "write its samples as a table with theta_in, phi_in, theta_out, phi_out and value, in a text or a spreadsheet"
)
_EVALUATED = f"evaluate it at pairs of directions, and {_AS_TABLE}"
# Patterns at the beginning of files that users may confuse with measurements; the first that matches names the kind.
_KINDS = {
    rb"\x89PNG": ("a PNG image", _PICTURE),
    rb"\xff\xd8\xff": ("a JPEG image", _PICTURE),
    rb"II\*\0|MM\0\*": ("a TIFF image", _PICTURE),
    rb"v/1\x01": ("an OpenEXR image", _PICTURE),
    rb"#\?(RADIANCE|RGBE)": ("a Radiance image", _PICTURE),
    rb"PK\x03\x04": ("a ZIP archive, as NumPy's .npz is", _UNPACK),
    rb"\x1f\x8b": ("packed by gzip", _UNPACK),
    rb"BZh[1-9]": ("packed by bzip2", _UNPACK),
    rb"\xfd7zXZ\0": ("packed by xz", _UNPACK),
    rb"\x28\xb5\x2f\xfd": ("packed by zstd", _UNPACK),
    rb"7z\xbc\xaf": ("a 7-Zip archive", _UNPACK),
    rb"version https://git-lfs": ("a Git LFS pointer in place of the file", "fetch the file with git lfs pull"),
    rb"SCATFUN": ("a Fourier BSDF (SCATFUN), the coefficients of a model", _EVALUATED),
    rb"(?s).*^#FORMAT[ \t]+binary": ("a binary file of ALTA", "write it as a text, with data2data of ALTA"),
    rb"[\x03\x30\x83\x8b\xf5](?s:.)[\x01-\x0c][\x01-\x1f](?s:.{8})\0\0": (
        "a dBase table (DBF)",
        "open it in a spreadsheet program, and save it as .xlsx or .csv",
    ),
    rb"SIMPLE  =": ("a FITS file", _AS_TABLE),
    rb"ENVI\s": ("the header of an ENVI image cube", _AS_TABLE),
    rb"NVIDIA ARC MBSDF": ("a measured BSDF of MDL (.mbsdf)", _AS_TABLE),
    rb"(?s).*^TypeColorModel\s": ("an Integra file (.ddr or .ddt)", _AS_TABLE),
    rb"(?s).*^DataType\s.*^ColorModel\s": ("a libbsdf file (.ssdd)", _AS_TABLE),
    rb"\x93NUMPY": ("a NumPy array (.npy)", f"{_AS_TABLE}, as numpy.savetxt does"),
    rb"\x80[\x02-\x05]": ("a Python pickle", _AS_TABLE),
    rb"\x89HDF": ("an HDF5 file, perhaps of MATLAB or netCDF", _AS_TABLE),
    rb"\x0e\x03\x13\x01": ("an HDF4 file", _AS_TABLE),
    rb"CDF[\x01\x02\x05]": ("a netCDF file", _AS_TABLE),
    rb"MATLAB ": ("a MATLAB file", _AS_TABLE),
    rb"PAR1|ARROW1": ("a Parquet or Arrow file", _AS_TABLE),
    rb"SQLite format 3": ("an SQLite database", _AS_TABLE),
    rb"tensor_file\0": ("an RGL .bsdf file", "dsbrdf convert turns it into a MERL file"),
    rb"%PDF": ("a PDF document", _AS_TABLE),
    rb"(?i)\s*<!doctype html|\s*<html": ("a web page", "download the file itself"),
    rb"(?s).*<WindowElement": ("a BSDF file of LBNL WINDOW (Klems XML or tensor tree)", _EVALUATED),
    rb"\s*<": ("XML", _AS_TABLE),
    rb"(?i)OPTIS - anisotropic bsdf": ("an anisotropic BSDF file of Speos", _AS_TABLE),
    rb"(?i)\W*TracePro": ("a TracePro file", _AS_TABLE),
    rb"\s*IESNA": ("the light distribution of a lamp (IES LM-63)", "a lamp has no BRDF"),
    rb"(?i)\s*@relation": ("an ARFF file", "save it as .csv"),
    rb"\s*PDS_VERSION_ID": ("a label of the Planetary Data System", "take the file that it describes"),
}


def known_kind(start: bytes) -> FileKind | None:
    """Name the kind of a file that is no measurement by its first bytes; return None for an unknown kind."""
    return next((FileKind(*kind) for pattern, kind in _KINDS.items() if re.match(pattern, start, re.M)), None)
