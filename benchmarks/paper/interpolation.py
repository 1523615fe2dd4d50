"""Materials between two others: the parameters of both, interpolated, and lit spheres of what they give.

Both are fitted with the same structure, `LOBES` lobes about the normal, whose lobes are matched by their order from
narrow to wide: of all matchings the one that changes widths least. Amplitude, kappa and the reach of a lobe, which
decides its half width, run geometrically from one material to the other, elongation linearly.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.paper.materials import Computed, Material, Numbers, choose, fit_quietly
from benchmarks.paper.paper_figure import Claim, PaperFigure, Row, draw_sphere, new_figure, sphere, to_bytes
from dsbrdf import DSBRDF, FitOptions
from dsbrdf.arrays import Array, Evaluate
from dsbrdf.data import THETA_DIFF
from dsbrdf.model import half_width
from dsbrdf.model.lobes import fall_to_half
from dsbrdf.rendering import exposure, sphere_normals

__all__ = ["FIGURE", "between"]


PREFERRED = (
    "nickel",
    "orange-paint",
    "vch_golden_yellow",
    "acrylic_felt_pink",
    "specular-blue-phenolic",
    "satin_purple",
)
"""Three pairs: a metal and a paint, a metallic paint and a felt, two plastics of different gloss."""
LOBES = 3
FRACTIONS_OF_SECOND = (0.0, 0.25, 0.5, 0.75, 1.0)
_FAMILY = FitOptions().lobe
_KNOTS = THETA_DIFF[::2]
_FAINTEST = 1e-9  # [1/sr]: what an amplitude is at least, so that it has a logarithm
_ASIDE = np.radians(45.0)
_SIZE = 96


def _choose(materials: Sequence[Material]) -> list[Material]:
    chosen = choose(materials, PREFERRED, len(PREFERRED))
    return chosen[: len(chosen) // 2 * 2]


def _measure(material: Material) -> Numbers:
    """Coordinates of a material, log amplitude (D, 3, K), log kappa, log reach and elongation (D, K); its sphere."""
    result = fit_quietly(material.measurement, FitOptions(n_lobes=LOBES, ring_lobes=0))
    at = result.model.parameters_at(_KNOTS)
    kappa, gamma = at["kappa"][:, 0], at["gamma"][:, 0]
    order = np.argsort(np.median(half_width(kappa, gamma, _FAMILY), axis=0))
    return {
        "log_amplitude": np.log(np.maximum(at["amplitude"], _FAINTEST))[..., order],
        "log_kappa": np.log(kappa)[:, order],
        "log_reach": np.log(fall_to_half(kappa, _FAMILY) / gamma)[:, order],
        "elongation": np.broadcast_to(at["elongation"], kappa.shape)[:, order],
        "sphere": sphere(material.measurement, _SIZE),
        "relative_rms": np.array(result.report.metrics.relative_rms),
    }


def between(first: Computed, second: Computed, share: float) -> DSBRDF:
    """Return the model at a share of the way from the first material to the second."""

    def mixed(name: str) -> Array:
        return np.asarray((1.0 - share) * first[name] + share * second[name])

    kappa = np.exp(mixed("log_kappa"))
    return DSBRDF(
        theta_diff=_KNOTS,
        amplitude=np.exp(mixed("log_amplitude")).transpose(1, 0, 2),
        kappa=kappa[None],
        gamma=(fall_to_half(kappa, _FAMILY) / np.exp(mixed("log_reach")))[None],
        elongation=mixed("elongation"),
        elongation_theta_diff=_KNOTS,
        interpolation="linear",
        lobe=_FAMILY,
    )


def _blend(first: DSBRDF, second: DSBRDF, share: float) -> Evaluate:
    """Values of two models, mixed: what one would do without parameters."""

    def evaluate(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        ends = (model.evaluate_unmasked(theta_half, theta_diff, phi_diff) for model in (first, second))
        return np.asarray(np.average(list(ends), axis=0, weights=[1.0 - share, share]))

    return evaluate


def _pairs(computed: Sequence[Computed]) -> list[tuple[Computed, Computed]]:
    return list(zip(computed[::2], computed[1::2], strict=False))


def _table(computed: Sequence[Computed]) -> list[Row]:
    return [
        {
            "material": first.name,
            "data": first.data,
            "other": second.name,
            "share": share,
            "way": way,
            "peak": peak,
            "at_45_degrees": aside,
            "highlight_half_width_deg": np.degrees(width),
        }
        for first, second in _pairs(computed)
        for way, seen in _seen(first, second).items()
        for share, (peak, aside, width) in zip(FRACTIONS_OF_SECOND, seen, strict=True)
    ]


def _seen(first: Computed, second: Computed) -> dict[str, Array]:
    """Peak, value at 45 degrees and half width of the highlight at theta_diff = 0, (steps, 3), of both ways."""
    ends = between(first, second, 0.0), between(first, second, 1.0)
    return {
        "parameters": np.array(
            [_highlight(between(first, second, share).evaluate_unmasked) for share in FRACTIONS_OF_SECOND]
        ),
        "values": np.array([_highlight(_blend(*ends, share)) for share in FRACTIONS_OF_SECOND]),
    }


def _highlight(evaluate: Evaluate) -> tuple[float, float, float]:
    angles = np.linspace(0.0, np.pi / 2, 1801)
    values = evaluate(angles, np.zeros_like(angles), np.full_like(angles, np.pi / 2)).mean(axis=1)
    below = np.flatnonzero(values < 0.5 * values[0])
    return (
        float(values[0]),
        float(np.interp(_ASIDE, angles, values)),
        float(angles[below[0]] if below.size else np.pi / 2),
    )


def _draw(computed: Sequence[Computed]) -> Figure:
    pairs = _pairs(computed)
    figure = new_figure(
        "Between two materials: parameters (above) and values (below) interpolated", 11.5, 3.6 * len(pairs)
    )
    axes = figure.subplots(2 * len(pairs), len(FRACTIONS_OF_SECOND) + 2, squeeze=False)
    for index, (first, second) in enumerate(pairs):
        ends = between(first, second, 0.0), between(first, second, 1.0)
        above, below = axes[2 * index], axes[2 * index + 1]
        for number, share in enumerate(FRACTIONS_OF_SECOND, start=1):
            parameters = sphere(between(first, second, share).evaluate_unmasked, _SIZE)
            _draw_exposed(above[number], parameters, f"{share:g}")
            _draw_exposed(below[number], sphere(_blend(*ends, share), _SIZE))
        for ax, one in zip(above[[0, -1]], (first, second), strict=True):
            _draw_exposed(ax, one["sphere"], f"data of\n{one.label}")
        above[1].set_ylabel("parameters", fontsize=8)
        below[1].set_ylabel("values", fontsize=8)
        for ax in below[[0, -1]]:
            ax.set_axis_off()
    return figure


def _draw_exposed(ax: Axes, picture: Array, caption: str = "") -> None:
    """Draw a sphere with its own exposure: materials may differ in brightness by more than a screen shows."""
    draw_sphere(ax, to_bytes(picture, exposure(picture, sphere_normals(_SIZE)[1])), caption)


def _claims(computed: Sequence[Computed]) -> list[Claim]:
    pairs = _pairs(computed)
    seen = [_seen(first, second) for first, second in pairs]
    steady = {way: sum(_steady(one[way]) for one in seen) for way in ("parameters", "values")}
    middle = FRACTIONS_OF_SECOND.index(0.5)
    widths = "; ".join(
        f"{first.label} to {second.label} "
        + ", ".join(f"{np.degrees(one[way][middle, 2]):.1f} ({way})" for way in ("parameters", "values"))
        + f" between {np.degrees(one['values'][0, 2]):.1f} and {np.degrees(one['values'][-1, 2]):.1f}"
        for (first, second), one in zip(pairs, seen, strict=True)
    )
    errors = ", ".join(f"{one.label} {float(one['relative_rms']):.3f}" for one in computed)
    return [
        Claim(
            "The model provides powerful handles for exploring the space of isotropic BRDFs.",
            "agrees" if steady["parameters"] == len(pairs) else "agrees in part" if steady["parameters"] else "differs",
            "Gloss, the peak over the value at 45 degrees, and the width of the highlight run without turning back from"
            f" one material to the other for {steady['parameters']} of {len(pairs)} pairs with parameters in between,"
            f" for {steady['values']} with values. Half width of the highlight half way [degrees]: {widths}. Values in"
            " between keep the sharper highlight and fade it; parameters change its width. relative_rms of the"
            f" {LOBES} lobes that are matched: {errors}.",
        )
    ]


def _steady(seen: Array) -> bool:
    """Whether gloss and width run one way, up to a tenth of the whole range, and never jump over half of it."""
    curves = np.log(seen[:, 0] / np.maximum(seen[:, 1], _FAINTEST)), np.log(seen[:, 2])
    for curve in curves:
        steps, whole = np.diff(curve), curve[-1] - curve[0]
        if np.any(steps * np.sign(whole) < -0.1 * abs(whole) - 0.05) or np.abs(steps).max() > 0.6 * abs(whole) + 0.1:
            return False
    return True


FIGURE = PaperFigure(
    name="interpolation",
    title="between two materials",
    shows=(
        "For each pair of materials: at the sides the data; between them, above, spheres of interpolated parameters"
        f" (fits with {LOBES} lobes each, matched from narrow to wide), below, of interpolated values. Every"
        " sphere has its own exposure."
    ),
    choose=_choose,
    measure=_measure,
    table=_table,
    draw=_draw,
    claims=_claims,
    at_least=2,
    settings=str(LOBES),
)
