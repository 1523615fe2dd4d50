"""A model as a MaterialX file: the OpenPBR surface that looks most like it.

A lit sphere of the surface and one of the model are compared as a screen shows them, under both lightings of
`dsbrdf.render_sphere`; least squares of the difference finds the inputs. OpenPBR has about a dozen numbers, so some
difference is left: it is stated in the file, as PSNR.
"""

from collections.abc import Callable
from dataclasses import fields

import numpy as np
from scipy.optimize import least_squares

from dsbrdf.arrays import Array, Evaluate
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import LIGHTINGS, render_sphere, sphere_likeness, sphere_normals
from dsbrdf.output.export.openpbr import Color, OpenPBR
from dsbrdf.version import __version__

_DOCUMENT = """\
<?xml version="1.0"?>
<materialx version="1.39" colorspace="lin_rec709">
  <open_pbr_surface name="dsbrdf_surface" type="surfaceshader" doc="{doc}">
{inputs}
  </open_pbr_surface>
  <surfacematerial name="dsbrdf_material" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="dsbrdf_surface" />
  </surfacematerial>
</materialx>
"""
_FIT_SIZES = {"three_lights": 32, "environment": 10}  # pixels along a side of the spheres that are fitted
_STATED_SIZE = 128  # of those whose PSNR is stated
_BRIGHTEST = 1e100
_STEPS = [1e-4]  # of derivatives, relative
_LEAST_ROUGHNESS = 0.03
_NAMES = ("base_metalness", "specular_weight", "specular_roughness", "coat_weight", "coat_roughness")
# Metalness, weight and roughness of the highlight, weight and roughness of the coat.
_STARTS = [
    start
    for roughness in (0.15, 0.3, 0.5)
    for start in (
        (0.02, 0.8, roughness, 0.05, 0.1),
        (0.95, 0.9, roughness, 0.05, 0.1),
        (0.1, 0.8, 0.5 + 0.5 * roughness, 0.8, 0.6 * roughness),
    )
]
_BOUNDS = np.zeros(6 + len(_NAMES)), np.ones(6 + len(_NAMES))
_BOUNDS[0][[8, 10]] = _LEAST_ROUGHNESS
_AWAY_FROM_THE_HIGHLIGHT = np.radians([[40.0, 50.0, 60.0], [10.0, 20.0, 5.0], [90.0, 90.0, 90.0]])
_POLISHED = 2  # starts, the best ones, that least squares improves


def materialx_document(model: DSBRDF) -> str:
    """Return a MaterialX 1.39 document, which is XML, with one material; see `fit_openpbr` for the surface in it."""
    surface, psnr = fit_openpbr(model.evaluate)
    error = ", ".join(f"{value:.1f} dB ({name})" for name, value in psnr.items())
    doc = (
        f"The OpenPBR surface nearest to a Directional Statistics BRDF model, written by dsbrdf {__version__}. "
        f"PSNR of a lit sphere against the model: {error}."
    )
    inputs = [_input(field.name, getattr(surface, field.name)) for field in fields(OpenPBR)]
    return _DOCUMENT.format(doc=doc, inputs="\n".join(inputs))


def _input(name: str, value: float | Color) -> str:
    numbers, kind = (value, "color3") if isinstance(value, tuple) else ((value,), "float")
    text = ", ".join(f"{number:.6g}" for number in numbers)
    return f'    <input name="{name}" type="{kind}" value="{text}" />'


def fit_openpbr(evaluate: Evaluate) -> tuple[OpenPBR, dict[str, float]]:
    """Find the OpenPBR surface that looks most like a material, and the PSNR [dB] of its lit spheres by lighting.

    Raises InvalidArgumentError if the values are too large for a picture.
    """
    targets = [_target(evaluate, lighting, size) for lighting, size in _FIT_SIZES.items()]

    def difference(numbers: Array) -> Array:
        surface = _surface(numbers)
        return np.concatenate([target(surface.evaluate) for target in targets])

    color = np.clip(np.median(evaluate(*_AWAY_FROM_THE_HIGHLIGHT), axis=0) * np.pi, 0.02, 0.95)
    starts = [np.concatenate([color, np.full(3, 0.9), start]) for start in _STARTS]
    starts.sort(key=lambda numbers: float(np.sum(difference(numbers) ** 2)))
    ends = [
        least_squares(difference, start, bounds=_BOUNDS, diff_step=_STEPS, max_nfev=30) for start in starts[:_POLISHED]
    ]
    surface = _surface(min(ends, key=lambda end: end.cost).x)
    return surface, {lighting: _psnr(evaluate, surface, lighting) for lighting in LIGHTINGS}


def _target(evaluate: Evaluate, lighting: str, size: int) -> Callable[[Evaluate], Array]:
    """Return what compares a surface with a picture: differences of the pixels of a sphere.

    Their mean square counts as much as that of any other picture.
    """
    picture, mask = render_sphere(evaluate, lighting=lighting, size=size), sphere_normals(size)[1]
    if not picture.max() < _BRIGHTEST:
        raise InvalidArgumentError("the values of the model are too large for a picture")
    factor = exposure(picture, mask)
    wanted = displayed(picture, factor)[mask]

    def difference(surface: Evaluate) -> Array:
        seen = displayed(render_sphere(surface, lighting=lighting, size=size), factor)[mask]
        return np.ravel(seen - wanted) / np.sqrt(wanted.size)

    return difference


def _surface(numbers: Array) -> OpenPBR:
    red, green, blue, *rest = numbers.tolist()
    return OpenPBR(
        (red, green, blue), specular_color=(rest[0], rest[1], rest[2]), **dict(zip(_NAMES, rest[3:], strict=True))
    )


def _psnr(evaluate: Evaluate, surface: OpenPBR, lighting: str) -> float:
    pair = [render_sphere(one, lighting=lighting, size=_STATED_SIZE) for one in (evaluate, surface.evaluate)]
    return sphere_likeness(pair[0], pair[1])[0]
