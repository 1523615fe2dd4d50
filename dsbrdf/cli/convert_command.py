"""The command ``dsbrdf convert``: a measurement as another kind of file."""

import argparse
from pathlib import Path

from dsbrdf.cli.arguments import add_json_option, print_json
from dsbrdf.cli.source_files import read_grid
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.merl import encode_merl
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.output.export.rgl import rgl_bsdf

_SUFFIXES = (".binary", ".bsdf")


def configure(parser: argparse.ArgumentParser, _: str) -> None:
    """Add the arguments of the command to its parser."""
    parser.set_defaults(run=_convert)
    parser.add_argument("input", type=Path, metavar="INPUT", help="a MERL .binary or an isotropic RGL .bsdf file")
    parser.add_argument(
        "output", type=Path, metavar="OUTPUT", help="the file to write; .bsdf is for Mitsuba 3, .binary a MERL table"
    )
    parser.add_argument(
        "--spectral", action="store_true", help="spectra in the .bsdf, for pbrt-v4 and spectral variants of Mitsuba"
    )
    add_json_option(parser)


def _convert(arguments: argparse.Namespace) -> int:
    suffix = arguments.output.suffix.lower()
    if suffix not in _SUFFIXES:
        raise InvalidArgumentError(f"{arguments.output}: the output must end in {' or '.join(_SUFFIXES)}")
    measurement = read_grid(arguments.input)
    if suffix == ".bsdf":
        content = rgl_bsdf(measurement, measurement.name, spectral=arguments.spectral)
    else:
        content = encode_merl(measurement)
    write_atomically(arguments.output, [content])
    if arguments.json:
        print_json({"output": str(arguments.output), "format": suffix[1:], "bytes": len(content)})
    return 0
