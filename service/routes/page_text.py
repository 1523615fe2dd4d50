"""What the pages say of a fit in words."""

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from dsbrdf.fitting.options import FitOptions
from service.storage.schema import FitRow
from service.wire.fit_options import DEFAULTS, canonical

_LOOKS = (
    (45.0, "cannot be told from"),
    (38.0, "is very close to"),
    (32.0, "is close to"),
    (26.0, "differs visibly from"),
)


DOWNLOADS = {
    "json": "the model and its report, without loss",
    "npz": "the same for NumPy",
    "csv": "a table of the parameters",
    "merl": "a table in the MERL format, 35 MB",
    "glsl": "a function for shaders, as in the sphere above",
    "brdf": "for Disney's BRDF Explorer",
    "bsdf": "for Mitsuba 3",
    "bsdf-spectral": "for its spectral variants and pbrt-v4",
    "materialx": "the OpenPBR surface that looks most like it; takes some seconds",
}
"""Formats of the export, and what each is for."""
FIGURES = {
    "parameters": "Amplitude, half width and elongation of each lobe over theta_diff",
    "residual": "Difference of fit and measurement over theta_half and theta_diff",
}
"""Figures that the page of a fit shows, and what is in them."""


@dataclass(frozen=True)
class Metric:
    """A number, what it is called, and what it means."""

    name: str
    value: str
    meaning: str


@dataclass(frozen=True)
class Facts:
    """What every page says of a fit: its name, when it was made, how good it is in a few words."""

    name: str
    date: str
    error: str


def facts_of(row: FitRow) -> Facts:
    """Return the facts of a fit."""
    error = (row.metrics or {}).get("relative_rms")
    date = datetime.fromtimestamp(row.created, UTC).strftime("%Y-%m-%d %H:%M UTC")
    return Facts(row.name or f"{row.measurement[:12]}…", date, "" if error is None else _percent(error))


def metrics_in_words(metrics: Mapping[str, float | None]) -> list[Metric]:
    """Return the metrics that a fit has, the most telling first."""
    given = {name: value for name, value in metrics.items() if value is not None}
    found = []
    if (psnr := given.get("psnr")) is not None:
        words = next((words for level, words in _LOOKS if psnr >= level), "differs strongly from")
        found.append(Metric("psnr", f"{psnr:.1f} dB", f"A lit sphere of the fit {words} one of the measurement."))
    found += [Metric(name, write(given[name]), meaning) for name, write, meaning in _METRICS if name in given]
    return found


def options_in_words(options: Mapping[str, Any]) -> str:
    """Return the options that are not the default."""
    return ", ".join(f"{name} = {_word(value)}" for name, value in _unusual(options).items()) or "default options"


def reproduction(row: FitRow, address: str) -> dict[str, str]:
    """Return the lines that give the same model from Python and by curl."""
    name, given = row.name or row.measurement[:12], _unusual(row.options)
    arguments = "".join(f", {option}={value!r}" for option, value in given.items() if not option.endswith("_deg"))
    angles = {option: value for option, value in given.items() if option.endswith("_deg")}
    for option, value in angles.items():
        radians = "None" if value is None else f"numpy.radians({value})"
        arguments += f", {option.removesuffix('_deg')}={radians}"
    options = f", dsbrdf.FitOptions({arguments[2:]})" if given else ""
    python = [
        "import dsbrdf" + ("\nimport numpy" if angles else ""),
        "",
        f'measurement = dsbrdf.read_merl("{name}.binary")',
        f"result = dsbrdf.fit(measurement{options})",
        'print(result.report.metrics["relative_rms"])',
        f'dsbrdf.save(result, "{name}.json")',
    ]
    query = "&".join(f"{option}={_word(value)}" for option, value in given.items())
    fits = f"{address}v1/fits"
    curl = [
        "# the fit, from the file",
        f"curl --data-binary {shlex.quote(f'@{name}.binary')} -H 'Content-Type: application/octet-stream' \\",
        f"  '{fits}{'?' if query else ''}{query}'",
        "# a picture of it",
        f"curl -o sphere.png '{fits}/{row.id}/figures/sphere.png?size=256'",
        "# values of the BRDF in 1/sr",
        f"curl '{fits}/{row.id}/brdf?theta_half_deg=10&theta_diff_deg=30'",
    ]
    return {"Python": "\n".join(python), "curl": "\n".join(curl)}


def _unusual(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that are not what their method does by default."""
    usual = canonical(FitOptions(method=options["method"]))
    given = {name: value for name, value in options.items() if value != usual[name]}
    return given if options["method"] == DEFAULTS["method"] else {"method": options["method"], **given}


def _word(value: Any) -> str:
    if isinstance(value, list):
        return ",".join(map(str, value))
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


# Beside psnr: the name of a metric, how its value is written, and what it means.
_METRICS: tuple[tuple[str, Callable[[float], str], str], ...] = (
    ("relative_rms", _percent, "Error of the values, relative to their size."),
    ("symmetric_floor", _percent, "What that error is for the best reciprocal model."),
    ("floor", _percent, "What it is for the best model that ignores φ_diff."),
    ("excess", "{:.3f}".format, "Error / floor; below 1, the fit gains by regarding φ_diff."),
    ("albedo_error", _percent, "Mean error of how much light is reflected in all."),
    ("male", "{:.4f}".format, "Mean error of the logarithm, which counts dark parts as well."),
    ("ssim", "{:.4f}".format, "Likeness of the two spheres' structure; 1 is equal."),
)
