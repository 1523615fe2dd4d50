"""What the pages say of a fit in words."""

from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from dsbrdf.fitting.layer_shares import LABELS
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.image_metrics import displayed

from ..storage.schema import FitRow
from ..wire.fit_options import DEFAULTS, canonical

FIGURES = {
    "parameters": ("Height over theta_diff and directional albedo of each component", 326),
    "residual": ("Difference of fit and measurement over theta_half and theta_diff", 326),
}
"""Figures that the page of a fit shows: what is in them, and for 1056 pixels of width the height to keep free."""
COMPONENT_MEANINGS = {
    "light": "Its share of all light at normal incidence; in brackets, where the share lies with 90 % probability.",
    "colour": "Red, green and blue of the albedo, over the largest.",
    "albedo": "Share of light at normal incidence that it reflects.",
    "alpha": "Roughness of its surface, that of GGX.",
    "half width": "θ_half at which slopes of its surface are half as frequent as at 0.",
    "tail": "Exponent κ: 2 as GGX, a smaller number falls more slowly, a large one is Beckmann's distribution.",
    "F0": "Reflectance of its surface at normal incidence.",
    "height in 1/sr": "Value in the middle of its layers, at normal incidence.",
}
"""Numbers of a component that the pages show, and what they mean."""


def facts_of(row: FitRow) -> dict[str, str]:
    """Return what every page says of a fit: its name, when it was made, its error in percent."""
    error = (row.metrics or {}).get("relative_rms")
    date = datetime.fromtimestamp(row.created, UTC).strftime("%Y-%m-%d %H:%M UTC")
    name = row.name or f"{row.measurement[:12]}…"
    return {"name": name, "date": date, "error": "" if error is None else _percent(error)}


def metrics_in_words(metrics: Mapping[str, float | None]) -> list[dict[str, str]]:
    """Return the metrics that a fit has, the most telling first: name, title, value and meaning of each."""
    return [
        {"name": name, "title": title, "value": write(value), "meaning": meaning}
        for name, title, write, meaning in _METRICS
        if (value := metrics.get(name)) is not None
    ]


def component_facts(component: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the pages show of a component's document: its name, its colour on a screen, and numbers as text."""
    color, (low, high), width = component["color"], component["ranges"]["light_share"], component["half_width_deg"]
    numbers = {
        "light": [f"{component['light_share']:.0%} ({low:.0%} to {high:.0%})"],
        "colour": _written(color, ".2f"),
        "albedo": _written(component["albedo"], ".3f"),
        "alpha": _known([component["alpha"]], ".3g"),
        "half width": ["–"] if width is None else [f"{width:.3g}°"],
        "tail": _known([component["kappa"]], ".2g"),
        "F0": _known(component["f0"] or [None], ".3g"),
        "height in 1/sr": _written(component["lobe"]["height"][0], ".3g"),  # the first angle is normal incidence
    }
    swatch = "#" + bytes(np.rint(255.0 * displayed(np.array(color))).astype(np.uint8).tolist()).hex()
    label = component["label"]
    name, place = label.replace("_", " "), LABELS.index(label)
    return {"label": label, "place": place, "name": name, "swatch": swatch, "numbers": numbers}


def options_in_words(options: Mapping[str, Any]) -> str:
    """Return the options that are not what their method does by default, and a method that is not the default."""
    usual = canonical(FitOptions(method=options["method"])) | {"method": DEFAULTS["method"]}
    given = {name: options[name] for name in ("method", *options) if options[name] != usual[name]}
    return ", ".join(f"{name} = {_word(value)}" for name, value in given.items()) or "default options"


def _known(values: Sequence[float | None], form: str) -> list[str]:
    """Return numbers, or a dash for one that a diffuse component does not have."""
    return ["–" if value is None else format(value, form) for value in values]


def _written(values: Sequence[float], form: str) -> list[str]:
    return [format(value, form) for value in values]


def _word(value: Any) -> str:
    if isinstance(value, list):
        return ",".join(map(str, value))
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


# The name of a metric, its title, how its value is written, and what it means.
_METRICS: tuple[tuple[str, str, Callable[[float], str], str], ...] = (
    ("psnr", "picture", "{:.1f} dB".format, "Peak signal-to-noise ratio of lit spheres of fit and measurement."),
    ("relative_rms", "values", _percent, "Root mean square error of the values, relative to their size."),
    ("albedo_error", "albedo", _percent, "Mean error of the albedo: of all the light that is reflected."),
    ("symmetric_floor", "reciprocal floor", _percent, "Error of the values of the best reciprocal model."),
    ("floor", "bivariate floor", _percent, "Error of the values of the best model that ignores φ_diff."),
    ("excess", "values / floor", "{:.3f}".format, "Below 1, the fit gains from its dependence on φ_diff."),
    ("male", "logarithm", "{:.4f}".format, "Mean absolute logarithmic error, which counts dark parts as well."),
    ("ssim", "structure", "{:.4f}".format, "Structural similarity of the two spheres; 1 is equal."),
)
