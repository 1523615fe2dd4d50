"""Define ``dsbrdf compare``, which prints metrics of materials side by side and the likeness of their spheres."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.parameters import (
    NO_TABLE_FLAGS,
    AboutTable,
    Json,
    OutputFile,
    SourceFile,
    is_measurement,
    named_part,
    read_measured,
    read_model,
)
from dsbrdf.cli.picture_commands import USUAL_LOOK, Look, check_png, titles
from dsbrdf.components.decomposition import decompose
from dsbrdf.data.files import write_atomically
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.metrics import METRICS
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import FunctionModel, RenderableModel
from dsbrdf.output.comparison import N_NUMBERS, fit_ggx
from dsbrdf.output.comparison import compare as compare_with
from dsbrdf.output.figure_panels import encode_figure
from dsbrdf.output.plots import samples_figure
from dsbrdf.output.report_text import lobes_phrase
from dsbrdf.output.sphere_panels import Panels, compare_spheres, component_panels, encode_png, one_below_another
from dsbrdf.samples.scattered_fit import relative_rms
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.samples.table_options import TableOptions


def compare(
    first: SourceFile,
    /,
    *more: SourceFile,
    beside: Annotated[tuple[str, ...], Parameter(name="--with", metavar="ggx|FILE.py")] = (),
    output: OutputFile | None = None,
    look: Look = USUAL_LOOK,
    json: Json = False,
    table: AboutTable = NO_TABLE_FLAGS,
) -> None:
    """Compare models or measurements with the first one, or a table of samples with a model.

    Parameters
    ----------
    beside
        Compare with this too: ggx fits two GGX highlights over a Lambertian ground to the first file; a Python file has
        a function evaluate(omega_in, omega_out) of unit vectors (n, 3) that returns values (n, 3) in 1/sr.
    output
        Write a picture, a .png file: the spheres with the exposure of the first sphere, their differences from the
        first, and the components of models; or, for a table, the samples, the fit and the residual.
    """
    if output is not None:
        check_png(output)
    paths = (first, *more)
    if len(paths) + len(beside) < 2:
        raise InvalidArgumentError("name a second file to compare with, or --with ggx")
    found = [_source(path, table, look.component) for path in paths]
    found += [_beside(word, found[0][0]) for word in beside]
    paths += tuple(Path("2 GGX" if word == "ggx" else word) for word in beside)
    sources, columns = zip(*found, strict=True)
    with_picture = output is not None
    if any(isinstance(source, ScatteredSamples) for source in sources):
        likeness, sentences, picture, shown = _samples_and_model(paths, sources, with_picture=with_picture)
    else:
        likeness, sentences, picture, shown = _spheres(paths, sources, look, with_picture=with_picture)
    if output is not None and picture is not None:
        write_atomically(output, [picture])
    if json:
        items = [{"file": str(path)} | column for path, column in zip(paths, columns, strict=True)]
        answer = likeness if len(likeness) > 1 else likeness[0]
        print_json({"items": items, "likeness": answer, "output": None if output is None else str(output)})
        return
    rows = list(dict.fromkeys(name for column in columns for name, value in column.items() if value is not None))
    width = max(map(len, rows)) + 2
    print(f"{'':<{width}}" + "".join(f"{path.stem[-20:]:>22}" for path in paths))
    for name in rows:
        if name == next((metric for metric in METRICS if metric in rows), None):
            print("each fit compared with its own measurement:")
        values = ("" if (value := column.get(name)) is None else value for column in columns)
        print(f"{name:<{width}}" + "".join(f"{one:>22}" if isinstance(one, str) else f"{one:>22.4g}" for one in values))
    print(*sentences, sep="\n")
    if output is not None:
        print(f"{output}: {shown}")


_Comparison = tuple[list[dict[str, float | None]], list[str], bytes | None, str]
"""Likeness of each source to the first source, sentences about it, a picture, and a description of the picture."""


def _samples_and_model(paths: Sequence[Path], sources: Sequence[Any], *, with_picture: bool) -> _Comparison:
    samples = next(source for source in sources if isinstance(source, ScatteredSamples))
    others = [path for path, source in zip(paths, sources, strict=True) if source is not samples]
    if len(others) > 1:
        raise InvalidArgumentError("a table of samples can be compared with one model only: name one model")
    model = read_model(others[0])[0]
    error = relative_rms(model.evaluate_directions(samples.omega_in, samples.omega_out), samples.values, samples.weight)
    sentence = f"at the {len(samples.values)} samples: relative_rms {error:.4g}"
    picture = encode_figure(samples_figure(samples, model)) if with_picture else None
    return [{"relative_rms": error}], [sentence], picture, "samples, fit and residual"


def _spheres(paths: Sequence[Path], sources: Sequence[Any], look: Look, *, with_picture: bool) -> _Comparison:
    is_fit = len(paths) == 2 and isinstance(sources[0], Measurement) and isinstance(sources[1], DSBRDF)
    names = ["measured", "fit"] if is_fit and paths[0].stem == paths[1].stem else titles(paths)
    light = look.light()
    likeness: list[dict[str, float | None]] = []
    sentences: list[str] = []
    rows: list[Panels] = [{}, {}] if len(paths) > 2 else [{}]
    drawn: dict[str, Any] = {"lighting": light, "size": look.size, "with_components": is_fit and with_picture}
    for name, source in zip(names[1:], sources[1:], strict=True):
        found = compare_spheres(sources[0], source, names=(names[0], name), factor=look.exposure, **drawn)
        likeness.append({"psnr": found.psnr if np.isfinite(found.psnr) else None, "ssim": found.ssim})
        spheres = "their lit spheres" if len(paths) == 2 else f"the lit spheres of {names[0]} and {name}"
        sentences.append(f"likeness of {spheres} {found.light}: PSNR {found.psnr:.1f} dB, SSIM {found.ssim:.4f}")
        panels = list(found.panels.items())
        rows[0] |= dict(panels[:2])
        rows[-1] |= {title if len(paths) == 2 else f"{name}: {title}": panel for title, panel in panels[2:]}
    if with_picture and not is_fit:
        models = [(name, source) for name, source in zip(names, sources, strict=True) if isinstance(source, DSBRDF)]
        rows += [component_panels(model, name, light, look.size, found.exposure or 1.0) for name, model in models]
    shown = f"{', '.join(title for row in rows for title in row)}; radiance times {found.exposure:.4g}"
    return likeness, sentences, encode_png(one_below_another(rows)) if with_picture else None, shown


def _source(path: Path, table: TableOptions, component: str | None) -> tuple[Any, dict[str, Any]]:
    """Read a model, a component of a model, or a measurement; return the object and its metrics by name."""
    if is_measurement(path):
        if component is not None:
            raise InvalidArgumentError(f"{path}: a measurement has no components; fit it first")
        return read_measured(path, table), {"kind": "measurement", "numbers": None} | dict.fromkeys(METRICS)
    model, report = read_model(path)
    if component is not None:
        return named_part(path, model, component), {"kind": component}
    about: dict[str, Any] = {"kind": lobes_phrase(model), "numbers": model.n_numbers}
    about |= {name: None if report is None else report.metrics[name] for name in METRICS}
    for part in decompose(model):
        name, alphas = part.label.replace("_", " "), [one.alpha for one in part.surfaces if one.alpha is not None]
        about |= {f"{name}: light": part.light_share, f"{name}: albedo": float(part.albedo.mean())}
        about |= {f"{name}: alpha": alphas[0]} if alphas else {}
    return model, about


def _beside(word: str, first: Any) -> tuple[RenderableModel, dict[str, Any]]:
    """Return a model that ``--with`` names, and its description and metrics relative to the first source by name."""
    if not isinstance(first, Measurement | RenderableModel):
        raise InvalidArgumentError("--with compares with a .binary or .bsdf file or a whole model; fit a table first")
    if word == "ggx":
        evaluate = first.interpolated.evaluate if isinstance(first, Measurement) else first.evaluate_unmasked
        model: RenderableModel = fit_ggx(evaluate)
        about: dict[str, Any] = {"kind": "2 GGX highlights", "numbers": N_NUMBERS}
    elif Path(word).suffix == ".py":
        model, about = FunctionModel(_function_in(Path(word))), {"kind": "a function"}
    else:
        raise InvalidArgumentError(f"--with must be ggx or a .py file, not {word!r}")
    if isinstance(first, Measurement):
        about |= asdict(compare_with(first, {word: model})[word])
    return model, about


def _function_in(path: Path) -> Any:
    """Run a Python file and return its function ``evaluate``; an error of the file names the file."""
    code = path.read_text(encoding="utf-8")
    try:
        names: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
        exec(compile(code, str(path), "exec"), names)  # noqa: S102 (the user names the file) # nosec B102
    except Exception as error:
        raise InvalidArgumentError(f"{path}: {type(error).__name__}: {error}") from error
    function = names.get("evaluate")
    if not callable(function):
        raise InvalidArgumentError(f"{path}: there is no function evaluate(omega_in, omega_out)")
    return function
