"""The command ``dsbrdf convert``: a measurement as another kind of file."""

from pathlib import Path

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.parameters import Json
from dsbrdf.cli.source_files import read_grid
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.merl import encode_merl
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.output.export.rgl import rgl_bsdf

_SUFFIXES = (".binary", ".bsdf")


def convert(source: Path, target: Path, /, *, spectral: bool = False, json: Json = False) -> int:
    """Write a measurement as another kind of file; return the exit code.

    Parameters
    ----------
    source
        A MERL .binary or an isotropic RGL .bsdf file.
    target
        The file to write; .bsdf is for Mitsuba 3, .binary a MERL table.
    spectral
        Spectra in the .bsdf, for pbrt-v4 and spectral variants of Mitsuba.
    """
    suffix = target.suffix.lower()
    if suffix not in _SUFFIXES:
        raise InvalidArgumentError(f"{target}: the output must end in {' or '.join(_SUFFIXES)}")
    measurement = read_grid(source)
    content = (
        rgl_bsdf(measurement, measurement.name, spectral=spectral) if suffix == ".bsdf" else encode_merl(measurement)
    )
    write_atomically(target, [content])
    if json:
        print_json({"output": str(target), "format": suffix[1:], "bytes": len(content)})
    return 0
