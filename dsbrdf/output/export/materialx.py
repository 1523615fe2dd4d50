"""Write a model as a MaterialX file with the OpenPBR surface that looks most like the model.

Lit spheres of the surface and of the model are compared as a screen shows them, under both lightings of
`dsbrdf.render_sphere`. Nonlinear least squares, started from the layers of the model, finds the inputs of the surface.
A dielectric or a metal, whose inputs a person can read and edit, is preferred to a mixture of both that looks somewhat
more like the model. Because OpenPBR has only about a dozen numbers, a difference from the model remains. The file
states the difference as the PSNR of the whole sphere, of the highlights (the brightest tenth), of pixels viewed at more
than 60 degrees, and of the other pixels.
"""

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from dsbrdf.arrays import Array, Evaluate
from dsbrdf.components.decomposition import decompose
from dsbrdf.components.layers import LayeredModel, SpecularLayer
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export.openpbr import OpenPBR
from dsbrdf.output.export.templates import filled, template
from dsbrdf.rendering.sphere import LIGHTINGS, displayed, exposure, render_sphere, sphere_likeness, sphere_normals
from dsbrdf.version import __version__

# A fit compares spheres of these diameters, by lighting.
_FITTED_SPHERE_SIZES_PX = {"three_lights": 32, "environment": 10}
_STATED_SPHERE_SIZE_PX = 128  # The PSNR in the exported document compares lit spheres of this diameter.
_MAX_RADIANCE = 1e100  # A model whose lit sphere has larger values is refused, because a picture would overflow.
_DERIVATIVE_STEPS = [1e-4]  # relative steps of the finite differences that give the derivatives of a fit
_COST_TOLERANCE = 1e-3  # The fit ends if a step lowers the squared error by a smaller fraction (0.004 dB).
_MAX_FIT_STEPS = 16
# The unknowns of a fit are base colour, specular colour and these inputs; the unknown for an index (ior) is its F0.
_FITTED_INPUTS = ("base_metalness", "specular_ior", "specular_roughness", "coat_weight", "coat_roughness", "coat_ior")
_MIN_ROUGHNESS = 0.03
# The bounds 0.18 and 0.1 are the F0 of the indices of refraction 2.5 and 1.9.
_INPUT_BOUNDS = (
    np.array([0.0] * 7 + [0.002, _MIN_ROUGHNESS, 0.0, _MIN_ROUGHNESS, 0.01]),
    np.array([1.0] * 7 + [0.18, 1.0, 1.0, 1.0, 0.1]),
)
# If the layers have no coat, the fit of a coat starts with this weight, roughness and F0.
_ABSENT_COAT_START = (0.05, 0.1, 0.053)
# Indices of the unknowns that are fitted for a simple dielectric; its other inputs are constant.
_DIELECTRIC = (0, 1, 2, 7, 8)
# Indices of the unknowns that are fitted for a simple metal; its other inputs are constant.
_METAL = (0, 1, 2, 3, 4, 5, 8)
# Indices of the unknowns that are fitted for a coat, in addition to the unknowns of the base.
_COAT = (9, 10, 11)
_MAX_COST_RATIO = 2.0  # A simple surface is preferred if its squared error is at most this times the smallest (3 dB).
_MIN_BOUND_DISTANCE = 0.02  # A fit starts at least this fraction of an input's range away from both bounds.
_START_WEIGHT = 0.003  # Small weight of the distance from the start, so that inputs without visible effect stay there.
_DIFFUSE_ANGLES = np.radians([[40.0, 50.0, 60.0], [10.0, 20.0, 5.0], [90.0, 90.0, 90.0]])
_HIGHLIGHT_QUANTILE = 0.9  # Pixels brighter than this quantile of all pixels count as highlights.
# A pixel counts as grazing if the cosine between its normal and the view is smaller.
_MAX_GRAZING_COSINE = np.cos(np.radians(60.0))


class FoundSurface(NamedTuple):
    """Surface, and the PSNR [dB] of its lit spheres by lighting and by region."""

    surface: OpenPBR
    by_lighting: dict[str, float]
    by_region: dict[str, float]


def materialx_document(model: DSBRDF | LayeredModel, title: str) -> str:
    """Return a MaterialX 1.39 document, which is XML, with the OpenPBR surface that looks most like a model.

    The material in the document is named after `title`, so that a program can load several documents. Raises
    InvalidArgumentError if the values of the model are too large for a picture.
    """
    for lighting, size in _FITTED_SPHERE_SIZES_PX.items():
        if not render_sphere(model.evaluate, lighting=lighting, size=size).max() < _MAX_RADIANCE:
            raise InvalidArgumentError("the values of the model are too large for a picture")
    layers = model if isinstance(model, LayeredModel) else decompose(model).layers
    found = fit_openpbr(model.evaluate, layers)
    error, regions = (
        ", ".join(f"{value:.1f} dB ({name})" for name, value in figures.items())
        for figures in (found.by_lighting, found.by_region)
    )
    doc = (
        f"The OpenPBR surface nearest to a Directional Statistics BRDF model, written by dsbrdf {__version__}. "
        f"PSNR of a lit sphere against the model: {error}. By region of both: {regions}."
    )
    inputs = []
    for field, value in vars(found.surface).items():
        numbers, kind = (value, "color3") if isinstance(value, tuple) else ((value,), "float")
        # Numbers have no exponents, because some readers of MaterialX refuse them; invisibly small numbers become 0.
        text = ", ".join(np.format_float_positional(round(one, 9), 7, fractional=False, trim="-") for one in numbers)
        inputs.append(f'    <input name="{field}" type="{kind}" value="{text}" />')
    name = re.sub("[^A-Za-z0-9]+", "_", title).strip("_")
    name = name if name[:1].isalpha() else f"material_{name}".rstrip("_")
    return filled(template("openpbr.mtlx"), {"DOC": doc, "INPUTS": "\n".join(inputs), "NAME": name})


def fit_openpbr(evaluate: Evaluate, layers: LayeredModel) -> FoundSurface:
    """Find the OpenPBR surface that looks most like a material, starting from its layers; prefer a simple surface."""
    targets = [_target(evaluate, lighting, size) for lighting, size in _FITTED_SPHERE_SIZES_PX.items()]

    def fit(start: Array, free: list[int]) -> tuple[float, OpenPBR]:
        def surface(numbers: Array) -> OpenPBR:
            whole = start.copy()
            whole[free] = numbers
            return _surface(whole)

        def difference(numbers: Array) -> Array:
            pull = _START_WEIGHT * (numbers - start[free])
            return np.concatenate([*(target(surface(numbers).evaluate) for target in targets), pull])

        end = least_squares(
            difference,
            start[free],
            bounds=(_INPUT_BOUNDS[0][free], _INPUT_BOUNDS[1][free]),
            diff_step=_DERIVATIVE_STEPS,
            ftol=_COST_TOLERANCE,
            max_nfev=_MAX_FIT_STEPS,
        )
        return float(end.cost), surface(end.x)

    ends = [fit(start, free) for start, free in _starts(layers)]
    limit = _MAX_COST_RATIO * min(cost for cost, _ in ends)
    surface = next(surface for cost, surface in ends if cost <= limit)
    return FoundSurface(surface, *_likeness(evaluate, surface))


def _starts(layers: LayeredModel) -> list[tuple[Array, list[int]]]:
    """Return the starts of fits, each with the indices of its unknowns: simple surfaces first, then all inputs.

    If the layers have two highlights, the narrower highlight becomes the coat.
    """
    specular = sorted((one for one in layers.layers if isinstance(one, SpecularLayer)), key=lambda one: one.alpha)
    ground = LayeredModel(tuple(one for one in layers.layers if not isinstance(one, SpecularLayer)))
    color = np.median(ground.evaluate(*_DIFFUSE_ANGLES), axis=0) * np.pi
    coat = _ABSENT_COAT_START
    if len(specular) > 1:
        coat = (0.9, _roughness(specular[0]), float(np.mean(specular[0].f0)))
    base = specular[-1] if specular else SpecularLayer((0.01,) * 3, 0.5, 0.5, 2.0, (0.0, 0.0), 0.0, 0.0)
    f0, roughness = np.array(base.f0), _roughness(base)
    tint = f0 / f0.max()
    lower, upper = _INPUT_BOUNDS
    margin = _MIN_BOUND_DISTANCE * (upper - lower)
    metal, dielectric = (
        np.clip(start, lower + margin, upper - margin)
        for start in (
            (*np.maximum(color, f0), 0.9, 0.9, 0.9, 0.9, 0.04, roughness, *coat),
            (*color, *tint, 0.05, f0.max(), roughness, *coat),
        )
    )
    plastic, pure = dielectric.copy(), metal.copy()
    plastic[3:7], pure[6] = (1.0, 1.0, 1.0, 0.0), 1.0
    simple = [(plastic, [*_DIELECTRIC]), (pure, [*_METAL])]
    if len(specular) > 1:
        simple = [(start, [*free, *_COAT]) for start, free in simple]
    else:
        plastic[9] = pure[9] = 0.0
    return [*simple, *((start, [*range(lower.size)]) for start in (metal, dielectric))]


def _roughness(layer: SpecularLayer) -> float:
    """Return the roughness of the GGX highlight that has the half width of a layer's highlight."""
    return float(np.sqrt(np.tan(layer.half_width) / np.sqrt(np.sqrt(2.0) - 1.0)))


def _target(evaluate: Evaluate, lighting: str, size: int) -> Callable[[Evaluate], Array]:
    """Return a function that computes the differences between pixels of lit spheres of a surface and a material.

    The differences are scaled so that all pictures have equal weights, regardless of their size.
    """
    picture, mask = render_sphere(evaluate, lighting=lighting, size=size), sphere_normals(size)[1]
    factor = exposure(picture, mask)
    wanted = displayed(picture, factor)[mask]

    def difference(surface: Evaluate) -> Array:
        seen = displayed(render_sphere(surface, lighting=lighting, size=size), factor)[mask]
        return np.ravel(seen - wanted) / np.sqrt(wanted.size)

    return difference


def _surface(numbers: Array) -> OpenPBR:
    red, green, blue, *rest = numbers.tolist()
    named = dict(zip(_FITTED_INPUTS, rest[3:], strict=True))
    for name in ("specular_ior", "coat_ior"):
        root = np.sqrt(named[name])
        named[name] = float((1.0 + root) / (1.0 - root))
    return OpenPBR((red, green, blue), specular_color=(rest[0], rest[1], rest[2]), **named)


def _likeness(evaluate: Evaluate, surface: OpenPBR) -> tuple[dict[str, float], dict[str, float]]:
    """Return the PSNR [dB] between lit spheres of a material and a surface, for each lighting and for each region."""
    normals, mask = sphere_normals(_STATED_SPHERE_SIZE_PX)
    grazing = normals[:, 2] < _MAX_GRAZING_COSINE
    errors, regions, by_lighting = [], [], {}
    for lighting in LIGHTINGS:
        wanted, seen = (
            render_sphere(one, lighting=lighting, size=_STATED_SPHERE_SIZE_PX) for one in (evaluate, surface.evaluate)
        )
        by_lighting[lighting] = sphere_likeness(wanted, seen)[0]
        factor = exposure(wanted, mask)
        errors.append(np.mean((displayed(wanted, factor) - displayed(seen, factor))[mask] ** 2, axis=-1))
        light = wanted[mask].sum(axis=-1)
        bright = ~grazing & (light > np.quantile(light, _HIGHLIGHT_QUANTILE))
        regions.append([bright, ~grazing & ~bright, grazing])
    error, places = np.concatenate(errors), np.concatenate(regions, axis=1)
    named = zip(("highlight", "rest", "grazing"), places, strict=True)
    # The PSNR of equal pictures would be infinite without a minimum of the squared error.
    squared = {name: max(float(np.mean(error[place])), 1e-12) for name, place in named if place.any()}
    return by_lighting, {name: float(-10.0 * np.log10(one)) for name, one in squared.items()}
