"""Write a model as a GLSL function for fragment shaders: OpenGL ES 3.0 (WebGL 2), OpenGL 3.3 and later.

In the templates ``model.glsl`` and ``layers.glsl``, ``dsbrdf`` stands for the name of the function.

Each parameter is a piecewise cubic polynomial in theta_diff; the coefficients of a piece are a ``vec4`` in a constant
array. One loop looks up all parameters, and a second loop sums the lobes, because some compilers make a copy of a
constant array for each place that indexes the array, and a copy of a function for each call. The formulas avoid
cancellation in single precision: tangents come from the sum and the difference of the directions, and the polynomials
are in Bernstein's form. The source defines ``log1p`` and ``expm1``, which GLSL lacks, and ``tan`` and ``atan`` with the
formulas of the library Cephes, because the functions of GLSL are too inaccurate.

The sampling functions have the formulas and names of `dsbrdf.model.sampling`. The module
`dsbrdf.output.export.glsl_layers` writes layers, and the division of a model among its components.
"""

import re

import numpy as np

from dsbrdf.components.component import Component
from dsbrdf.components.layers import LayeredModel
from dsbrdf.components.shares import LABELS
from dsbrdf.data.geometry import CENTER_CUTOFF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import GRAZING_COSINE
from dsbrdf.model.sampling import ANGLES, DirectionSampler, direction_sampler
from dsbrdf.output.export.glsl_layers import layered_function, shares_function
from dsbrdf.output.export.single_precision import bernstein_pieces, constant, constant_array, literal
from dsbrdf.output.export.templates import filled, sections
from dsbrdf.version import __version__

NAME = "dsbrdf"
"""Default name of the exported GLSL function."""
_TEMPLATES = sections("model.glsl")
_NAME_PATTERN = r"(?!gl_)[A-Za-z](_?[A-Za-z0-9]){0,63}"
_RESERVED_WORDS = (
    " active asm attribute buffer case cast centroid class coherent common const continue default discard do double "
    "else enum extern external false filter fixed flat float for goto half highp if in inline inout input int "
    "interface invariant layout long lowp main mediump namespace noinline noperspective out output packed partition "
    "patch precise precision public readonly resource restrict return sample shared short sizeof smooth static struct "
    "subroutine superp switch template this true typedef uint uniform union unsigned using varying void volatile "
    "while writeonly abs acos acosh all any asin asinh atan atanh bool ceil clamp cos cosh cross degrees determinant "
    "distance dot equal exp floor fract inverse isinf isnan length log max min mix mod modf normalize not pow radians "
    "reflect refract round sign sin sinh sqrt step tan tanh texture transpose trunc "
)


def glsl_function(source: DSBRDF | LayeredModel | Component, name: str = NAME, *, sampling: bool = False) -> str:
    """Return GLSL source with ``vec3 dsbrdf(vec3 omega_in, vec3 omega_out)``.

    The function returns the BRDF in 1/sr, without the cosine; directions are unit vectors in the frame whose z axis is
    the normal. Every name in the source begins with `name`, so that a program can hold several models. The layers of a
    `LayeredModel` become a readable function of some 60 lines. The source of a component also has
    ``vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown)``, the sum of its model's components weighted by
    ``shown``. With `sampling`, ``vec3 dsbrdf_sample(vec3 omega_out, vec3 random)`` and
    ``float dsbrdf_pdf(vec3 omega_in, vec3 omega_out)`` are added, see `dsbrdf.model.sampling`.

    Raises InvalidArgumentError if a parameter is too large for single precision, or GLSL does not allow the name.
    """
    if not re.fullmatch(_NAME_PATTERN, name) or f" {name} " in _RESERVED_WORDS:
        raise InvalidArgumentError(
            f"{name!r} cannot be the name of a GLSL function: it must begin with a letter, have at most 64 letters and "
            "digits with single underscores between them, and must not be a word of GLSL"
        )
    head = _TEMPLATES["header of sampling"] if sampling else ""
    if isinstance(source, LayeredModel):
        parts = [head, layered_function(source), _TEMPLATES["angle"] if sampling else ""]
    elif isinstance(source, DSBRDF):
        parts = [_TEMPLATES["header"], head, _TEMPLATES["frame"], *_model_parts(source), _TEMPLATES["whole"]]
    else:
        weights = ", ".join(f"{float(label == source.label)}" for label in LABELS)
        about = _TEMPLATES["header of component"].replace("LABEL", source.label.replace("_", " "))
        parts = [_TEMPLATES["header"], head, _TEMPLATES["frame"], about, *_model_parts(source.whole.model)]
        parts += [shares_function(source), _TEMPLATES["one component"].replace("WEIGHTS", weights)]
    if sampling:
        sampler = direction_sampler(source.evaluate_unmasked) if isinstance(source, Component) else source.sampler
        parts.append(_sampling_functions(sampler))
    return f"// Written by dsbrdf {__version__}.\n" + "".join(parts).replace("dsbrdf", name)


def _model_parts(model: DSBRDF) -> list[str]:
    """Return the source of ``vec3 dsbrdf_model(dsbrdf_Angles angles)`` and of the functions that it calls."""
    constants = constant("GRAZING_FOURTH", GRAZING_COSINE**4)
    constants += constant("DELTA_TANGENT", float(np.tan(CENTER_CUTOFF)))
    common = _TEMPLATES["precision"], constants, *(_TEMPLATES[name] for name in ("math", "angle", "angles"))
    exp, height = ("exp", "exp") if model.interpolation == "spline" else ("", "dsbrdf_expm1")
    lobes, shapes = model.n_lobes, model.kappa.shape[0]
    rows, count = _parameter_rows(model)
    centers, delta = 4 * lobes + 2 * shapes * lobes, "result += vec3({0}[{1}], {0}[{2}], {0}[{3}]);"
    text = _TEMPLATES["lobe"].replace("FALL", _TEMPLATES[model.lobe]) + _TEMPLATES["model"]
    words = {
        "CENTER": f"rows[{centers} + shape]" if model.center.any() else "0.0",
        "DELTA": delta.format("rows", *range(count - 3, count)) if model.delta.any() else "",
        "HEIGHT": height,
        "EXP": exp,
        "COUNT": count,
        "LOBES": lobes,
        "SHAPES": shapes,
        "KAPPA": 3 * lobes,
        "GAMMA": (3 + shapes) * lobes,
        "ELONGATION": (3 + 2 * shapes) * lobes,
        "ALL": "value" if shapes == 3 else "value.xxx",
    }
    return [*common, rows, filled(text, words)]


def _parameter_rows(model: DSBRDF) -> tuple[str, int]:
    """Return the source of ``void dsbrdf_rows(float theta_diff, out float rows[n])`` with its constants, and n.

    The array ``rows`` has the parameters at theta_diff: amplitude (channel, lobe), kappa and gamma (1 or 3 channels,
    lobe) and elongation (lobe). If they are not 0, the centers of ring lobes and the delta term of the paper's model
    follow. Parameters are on the scale on which they are interpolated, such as the logarithm.
    """
    (breaks, coefficients), k = bernstein_pieces(model, "GLSL"), model.n_lobes
    sk = model.kappa.shape[0] * k
    parts = np.split(coefficients, np.cumsum([3 * k, sk, sk, sk, k]))
    order = [parts[0], parts[1], parts[2], parts[4]]
    order += [part for part, used in ((parts[3], model.center.any()), (parts[5], model.delta.any())) if used]
    coefficients = np.concatenate(order)
    later = " + ".join(f"int(held >= {literal(at)})" for at in breaks[1:-1].tolist()) or "0"
    ends = {"FIRST": literal(breaks[0]), "LAST": literal(breaks[-1]), "LATER": later}
    functions = filled(_TEMPLATES["rows"], ends | {"PIECES": breaks.size - 1, "COUNT": len(coefficients)})
    constants = constant_array("float", "dsbrdf_BREAKS", breaks[:, np.newaxis])
    constants += constant_array("vec4", "dsbrdf_TERMS", coefficients.reshape(-1, 4))
    return constants + functions, len(coefficients)


def _sampling_functions(sampler: DirectionSampler) -> str:
    """Return the source of ``dsbrdf_sample`` and ``dsbrdf_pdf``, which both call ``dsbrdf_angle``."""
    share = np.diff(sampler.cumulative, axis=1, prepend=0.0)[:, :-1]
    parts = np.stack([sampler.along, sampler.across, share], axis=-1)
    constants = constant("STEP", float(ANGLES[1])) + constant_array("vec3", "dsbrdf_MIXTURE", parts.reshape(-1, 3))
    return f"\n{constants}{filled(_TEMPLATES['sampling'], {'PARTS': parts.shape[1], 'LAST': ANGLES.size - 1})}"
