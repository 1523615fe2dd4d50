"""The command ``dsbrdf convert``: a measurement as another kind of file."""

from pathlib import Path
from typing import Any

from dsbrdf.cli.arguments import print_json, print_warning, print_written
from dsbrdf.cli.parameters import Json
from dsbrdf.cli.source_files import named_in_errors, read_grid
from dsbrdf.data.atomic_write import write_atomically
from dsbrdf.data.merl import encode_merl
from dsbrdf.data.rgl_material import read_rgl
from dsbrdf.data.sample_tables import TABLE_SUFFIXES, read_samples
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.output.export.merl import merl_table
from dsbrdf.output.export.rgl import rgl_bsdf

_SUFFIXES = (".binary", ".bsdf")
_LARGEST_DIFFERENCE = 0.1  # of swapped directions that a reciprocal file may hide without a warning


def convert(source: Path, target: Path, /, *, spectral: bool = False, json: Json = False) -> int:
    """Write a measurement as another kind of file; return the exit code.

    Parameters
    ----------
    source
        A MERL .binary file, an isotropic RGL .bsdf file, or a table of samples, .csv, .tsv or .txt, which is fitted
        first: the file has the values of the fit.
    target
        The file to write; .bsdf is for Mitsuba 3, .binary a MERL table.
    spectral
        Spectra in the .bsdf, for pbrt-v4 and spectral variants of Mitsuba.
    """
    suffix = target.suffix.lower()
    if suffix not in _SUFFIXES:
        raise InvalidArgumentError(f"{target}: the output must end in {' or '.join(_SUFFIXES)}")
    of_table, of_bsdf = source.suffix.lower() in TABLE_SUFFIXES, source.suffix.lower() == ".bsdf"
    convert_source = _of_table if of_table else _of_bsdf if of_bsdf else _of_grid
    content, sentences, about = convert_source(source, suffix, spectral=spectral)
    write_atomically(target, [content])
    for sentence in sentences:
        print_warning(f"{source}: {sentence}")
    if json:
        print_json({"output": str(target), "format": suffix[1:], "bytes": len(content)} | about)
    else:
        print_written(target, "a MERL table" if suffix == ".binary" else "an RGL file")
    if about and not json:
        print(f"{target}: " + "; ".join(f"{name.replace('_', ' ')} {value:.1%}" for name, value in about.items()))
    return 0


def _of_grid(source: Path, suffix: str, *, spectral: bool) -> tuple[bytes, tuple[str, ...], dict[str, Any]]:
    """Content of the file, sentences to warn with, and figures."""
    measurement = read_grid(source)
    if suffix == ".binary":
        return encode_merl(measurement), (), {}
    return rgl_bsdf(measurement, measurement.name, spectral=spectral), (), {}


def _of_bsdf(source: Path, suffix: str, *, spectral: bool) -> tuple[bytes, tuple[str, ...], dict[str, Any]]:
    """As `_of_grid`; only a MERL table needs the means of both orders of the directions."""
    with named_in_errors(source):
        material = read_rgl(source)
        if suffix == ".bsdf":
            return rgl_bsdf(material, material.name, spectral=True) if spectral else source.read_bytes(), (), {}
        difference = material.non_reciprocity()
        warning = (
            f"values of swapped directions differ by {difference:.0%} in the median, and a MERL table has one "
            "value for both, their mean: pictures change."
        )
        sentences = (warning,) if difference > _LARGEST_DIFFERENCE else ()
        return encode_merl(material.measurement()), sentences, {"non_reciprocity": difference}


def _of_table(source: Path, suffix: str, *, spectral: bool) -> tuple[bytes, tuple[str, ...], dict[str, Any]]:
    """As `_of_grid`, of a fit with the default options."""
    with named_in_errors(source):
        result = fit(read_samples(source), FitOptions())
    content = (
        merl_table(result.model) if suffix == ".binary" else rgl_bsdf(result.model, source.stem, spectral=spectral)
    )
    return content, result.report.warnings, {"error_of_the_fit": result.report.metrics.relative_rms}
