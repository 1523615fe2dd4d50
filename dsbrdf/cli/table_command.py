"""The command ``dsbrdf table``: what is understood of a table of samples, before it is fitted."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.parameters import NO_TABLE_FLAGS, AboutTable, Json, named_in_errors
from dsbrdf.data.grid import CHANNELS
from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.output.table_summary import ANGLE_NAMES, summary_of_table
from dsbrdf.samples.reading import TABLE_SUFFIXES, is_table, read_table


def table(file: Path, /, *, json: Json = False, options: AboutTable = NO_TABLE_FLAGS) -> None:
    """Print what is understood of a table of samples: columns, units, ranges, what is missing, the first samples.

    Parameters
    ----------
    file
        A .csv, .tsv, .txt, .astm or .xlsx file, or a .bsdf file of Zemax.
    """
    with named_in_errors(file):
        if not is_table(file):
            raise InvalidArgumentError(f"a table of samples ends in {one_of(TABLE_SUFFIXES)}")
        found = read_table(file.read_bytes(), file.stem, options)
    about = summary_of_table(found)
    if json:
        print_json({"file": str(file)} | about)
    else:
        print(f"{file.stem}: {about['n_rows']} rows, {about['n_samples']} samples", "", *_text(about), sep="\n")


def _text(about: dict[str, Any]) -> Iterator[str]:
    width = max(len("column"), *(len(column["name"]) for column in about["columns"])) + 2
    yield f"{'column':<{width}}{'read as':<13}unit"
    for column in about["columns"]:
        yield f"{column['name']:<{width}}{column['read_as'] or 'not read':<13}{column['unit']}".rstrip()
    yield ""
    for name, (low, high) in about["ranges"].items():
        unit = "1/sr" if name in CHANNELS else "degrees"
        yield f"{name:<18}{low:.4g} to {high:.4g} {unit}"
    if about["angles_of_incidence"]:
        yield "angles of incidence: " + ", ".join(f"{angle:g}" for angle in about["angles_of_incidence"])
    yield f"in the plane of incidence: {about['in_plane_of_incidence']:.0%} of the samples"
    yield ""
    yield from (f"warning: {sentence}" for sentence in about["warnings"])
    yield "".join(f"{name:>18}" for name in ANGLE_NAMES) + "".join(f"{name:>12}" for name in CHANNELS)
    for row in about["first"]:
        yield "".join(f"{angle:>18.2f}" for angle in row[:3]) + "".join(f"{value:>12.4g}" for value in row[3:])
