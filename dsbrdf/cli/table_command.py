"""Define ``dsbrdf table``, which prints how a table of samples is read, before the samples are fitted."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from dsbrdf.cli.arguments import BAD_INPUT, print_json
from dsbrdf.cli.parameters import NO_TABLE_FLAGS, AboutTable, Json, named_in_errors
from dsbrdf.data.geometry import CHANNELS
from dsbrdf.errors import DSBRDFError, InvalidArgumentError
from dsbrdf.output.documents import ANGLE_NAMES, summary_of_table
from dsbrdf.samples.layouts import LAYOUTS
from dsbrdf.samples.reading import read_table
from dsbrdf.samples.table_options import TableOptions


def table(*files: Path, layouts: bool = False, json: Json = False, options: AboutTable = NO_TABLE_FLAGS) -> int:
    """Print how a table of samples is read: columns, units, ranges, warnings and the first samples.

    Parameters
    ----------
    files
        Texts, spreadsheets, or .bsdf files of Zemax; several files get a line each.
    layouts
        Print the layouts of tables that are read, each with a line of such a file.
    """
    if layouts:
        width = max(len(layout.name) for layout in LAYOUTS) + 2
        print("\n".join(f"{layout.name:<{width}}{layout.example}" for layout in LAYOUTS))
        return 0
    if not files:
        raise InvalidArgumentError("name the file of a table, or give --layouts")
    if len(files) > 1:
        return _list(files, options.options(), json=json)
    (file,) = files
    with named_in_errors(file):
        about = summary_of_table(read_table(file.read_bytes(), file.stem, options.options()))
    if json:
        print_json({"file": str(file)} | about)
    else:
        print(f"{file.stem}: {about['n_rows']} rows, {about['n_samples']} samples", "", *_text(about), sep="\n")
    return 0


def _list(files: Sequence[Path], options: TableOptions, *, json: bool) -> int:
    """Print a line for each file, with a summary or the reason why the file cannot be read; return the exit code."""
    documents, width = [], max(len(str(file)) for file in files) + 2
    for file in files:
        document: dict[str, Any] = {"file": str(file), "error": None}
        try:
            document |= summary_of_table(read_table(file.read_bytes(), file.stem, options))
        except (DSBRDFError, OSError) as error:
            document["error"] = error.strerror if isinstance(error, OSError) else str(error)
        documents.append(document)
        if not json:
            print(f"{file!s:<{width}}{_line(document)}", flush=True)
    if json:
        print_json({"items": documents})
    return BAD_INPUT if any(document["error"] for document in documents) else 0


def _line(document: dict[str, Any]) -> str:
    if document["error"]:
        return f"not read: {document['error']}"
    (low, high), incidence = document["ranges"]["theta_out_deg"], document["angles_of_incidence_deg"]
    at = f"theta_in {', '.join(f'{angle:g}' for angle in incidence)}" if incidence else "many theta_in"
    warned = len(document["warnings"])
    plural = "warning" if warned == 1 else "warnings"
    values = max(document["ranges"][channel][1] for channel in CHANNELS)
    return (
        f"{document['n_samples']} samples, {at}, theta_out {low:.3g} to {high:.3g}, up to {values:.3g}/sr, "
        f"{warned} {plural}"
    )


def _text(about: dict[str, Any]) -> Iterator[str]:
    width = max(len("column"), *(len(column["name"]) for column in about["columns"])) + 2
    yield f"{'column':<{width}}{'read as':<13}unit"
    for column in about["columns"]:
        yield f"{column['name']:<{width}}{column['read_as'] or 'not read':<13}{column['unit']}".rstrip()
    yield ""
    for name, (low, high) in about["ranges"].items():
        unit = "1/sr" if name in CHANNELS else "degrees"
        yield f"{name.removesuffix('_deg'):<11}{low:.4g} to {high:.4g} {unit}"
    if about["angles_of_incidence_deg"]:
        yield "angles of incidence: " + ", ".join(f"{angle:g}" for angle in about["angles_of_incidence_deg"])
    yield f"in the plane of incidence: {about['in_plane_of_incidence']:.0%} of the samples"
    yield ""
    yield from (f"warning: {sentence}" for sentence in about["warnings"])
    yield "".join(f"{name.removesuffix('_deg'):>11}" for name in ANGLE_NAMES) + "".join(
        f"{name:>12}" for name in CHANNELS
    )
    for row in about["first"]:
        yield "".join(f"{angle:>11.2f}" for angle in row[:3]) + "".join(f"{value:>12.4g}" for value in row[3:])
