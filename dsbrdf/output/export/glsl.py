"""Write a model as a GLSL function for fragment shaders: OpenGL ES 3.0 (WebGL 2), OpenGL 3.3 and later.

In the templates, ``dsbrdf`` stands for the name of the function.

The parameters are cubic polynomials in theta_diff, a ``vec4`` each, in constant arrays of some kilobytes. One loop
looks up all parameters, and a second loop sums the lobes: some compilers copy a constant array wherever it is indexed,
and functions wherever they are called. The formulas avoid cancellation in single precision: tangents come from the
sum and the difference of the directions, and the polynomials are in Bernstein's form. The functions ``log1p``,
``expm1``, ``tan`` and ``atan``, for which a shader's own functions are too coarse, are spelled out; the last two are
the rational reductions and polynomials of Cephes.

Layers, and the division of a model among its components, are in `dsbrdf.output.export.glsl_layers`.
"""

import re

import numpy as np

from dsbrdf.components.decomposition import Component
from dsbrdf.components.layers import LayeredModel
from dsbrdf.components.shares import LABELS
from dsbrdf.data.grid import CENTER_CUTOFF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import GRAZING_COSINE
from dsbrdf.model.sampling import direction_sampler
from dsbrdf.output.export.glsl_layers import layered_function, shares_function
from dsbrdf.output.export.glsl_sampling import HEADER_OF_SAMPLING, sampling_functions
from dsbrdf.output.export.single_precision import bernstein_pieces, constant, constant_array, filled, literal
from dsbrdf.version import __version__

NAME = "dsbrdf"
"""Default name of the function."""
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

    Parameters
    ----------
    source : DSBRDF, LayeredModel or Component
        The layers of a `LayeredModel` become a function of some 60 lines that is meant to be read. The source for a
        component also has ``vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown)``: all components of its
        model, times the weights ``shown`` of specular spike, specular lobe and diffuse.
    name : str, optional
        Name of the function, by default ``dsbrdf``. Every name in the source begins with it, so that a program can
        hold several models.
    sampling : bool, optional
        Add ``vec3 dsbrdf_sample(vec3 omega_out, vec3 random)`` and ``float dsbrdf_pdf(vec3 omega_in, vec3 omega_out)``,
        see `dsbrdf.model.sampling`.

    Returns
    -------
    str
        The function returns the BRDF, without the cosine, in 1/sr; the directions are unit vectors in the frame whose
        z axis is the normal.

    Raises
    ------
    InvalidArgumentError
        If a parameter is too large for single precision, or the name cannot be that of a function.
    """
    if not re.fullmatch(_NAME_PATTERN, name) or f" {name} " in _RESERVED_WORDS:
        raise InvalidArgumentError(
            "the name of a GLSL function must begin with a letter, have at most 64 letters and digits with single "
            f"underscores between them, and be no word of GLSL, unlike {name!r}"
        )
    parts = [_HEADER, HEADER_OF_SAMPLING if sampling else "", _FRAME]
    if isinstance(source, LayeredModel):
        parts = [HEADER_OF_SAMPLING if sampling else "", layered_function(source), _ANGLE if sampling else ""]
    elif isinstance(source, DSBRDF):
        parts += [_PRECISION, _MATH, _ANGLE, _ANGLES, _model_function(source), _WHOLE]
    else:
        weights = ", ".join(f"{float(label == source.label)}" for label in LABELS)
        parts += [_HEADER_OF_COMPONENT.replace("LABEL", source.label.replace("_", " ")), _PRECISION, _MATH, _ANGLE]
        parts += [_ANGLES, _model_function(source.whole.model), shares_function(source)]
        parts.append(_ONE_COMPONENT.replace("WEIGHTS", weights))
    if sampling:
        sampler = direction_sampler(source.evaluate_unmasked) if isinstance(source, Component) else source.sampler
        parts.append(sampling_functions(sampler))
    return f"// Written by dsbrdf {__version__}.\n" + "".join(parts).replace("dsbrdf", name)


def _model_function(model: DSBRDF) -> str:
    """Return ``vec3 dsbrdf_model(dsbrdf_Angles angles)``, and the functions that it needs beyond `_ANGLES`."""
    exp, height = ("exp", "exp") if model.interpolation == "spline" else ("", "dsbrdf_expm1")
    lobes, shapes = model.n_lobes, model.kappa.shape[0]
    rows, count = _parameter_rows(model, "dsbrdf")
    centers, delta = 4 * lobes + 2 * shapes * lobes, "result += vec3({0}[{1}], {0}[{2}], {0}[{3}]);"
    text = _LOBE.replace("FALL", _LOBE_BODIES[model.lobe]) + _MODEL
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
    return rows + filled(text, words)


def _parameter_rows(model: DSBRDF, table: str) -> tuple[str, int]:
    """Return ``void {table}_rows(float theta_diff, out float rows[n])`` with its constants, and n.

    The rows are heights (channel, lobe), kappa and gamma (shape, lobe), elongation (lobe), then, where there are any,
    center (shape, lobe) and the delta term, all on the scale of the interpolation.
    """
    (breaks, coefficients), k = bernstein_pieces(model, "GLSL"), model.n_lobes
    sk = model.kappa.shape[0] * k
    parts = np.split(coefficients, np.cumsum([3 * k, sk, sk, sk, k]))
    order = [parts[0], parts[1], parts[2], parts[4]]
    order += [part for part, used in ((parts[3], model.center.any()), (parts[5], model.delta.any())) if used]
    coefficients = np.concatenate(order)
    later = " + ".join(f"int(held >= {literal(at)})" for at in breaks[1:-1].tolist()) or "0"
    ends = {"FIRST": literal(breaks[0]), "LAST": literal(breaks[-1]), "LATER": later}
    functions = filled(_ROWS, ends | {"PIECES": breaks.size - 1, "COUNT": len(coefficients)})
    constants = constant_array("float", "dsbrdf_table_BREAKS", breaks[:, np.newaxis])
    constants += constant_array("vec4", "dsbrdf_table_TERMS", coefficients.reshape(-1, 4))
    return (constants + functions).replace("dsbrdf_table", table), len(coefficients)


_HEADER = """\
// A measured BRDF as a function: Directional Statistics BRDF model.
//
//   vec3 dsbrdf(vec3 omega_in, vec3 omega_out)
//
// returns the BRDF in 1/sr for red, green and blue (linear), without the cosine. Below the horizon it is 0.
//
"""

_FRAME = """\
// Directions point away from the surface; they are unit vectors in the frame whose z axis is the normal.
//
"""

_HEADER_OF_COMPONENT = """\
// This is a component of the material, the LABEL.
//
//   vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown)
//
// returns the weighted sum of all components; the weights are shown.x for the specular spike, shown.y for the specular
// lobe and shown.z for the diffuse part. An absent component is 0. With vec3(1.0), the sum is the whole material.
//
"""

_PRECISION = """\
// Needs GLSL ES 3.00 (WebGL 2) or GLSL 3.30. WARNING: mediump, which may be 16 bits, is too coarse: the highlight would
// be wrong or missing. The two lines below set highp from here on; pass directions that were computed in highp.
#ifdef GL_ES
precision highp float;
precision highp int;
#endif

"""

_MATH = (
    constant("GRAZING_FOURTH", GRAZING_COSINE**4)
    + constant("DELTA_TANGENT", float(np.tan(CENTER_CUTOFF)))
    + """
float dsbrdf_log1p(float x) {
  float s = x / (2.0 + x), t = s * s;
  float series = 2.0 * s * (1.0 + t * (1.0 / 3.0 + t * (0.2 + t * (1.0 / 7.0 + t * (1.0 / 9.0)))));
  return x < 0.5 ? series : log(1.0 + x);
}

float dsbrdf_expm1(float x) {
  float series =
    x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0 + x * (1.0 / 720.0))))));
  return abs(x) < 0.3 ? series : exp(x) - 1.0;
}

vec3 dsbrdf_expm1(vec3 x) {
  return vec3(dsbrdf_expm1(x.r), dsbrdf_expm1(x.g), dsbrdf_expm1(x.b));
}

float dsbrdf_tan(float x) {
  float a = abs(x);
  float y = a > 0.7853981634 ? (1.5707963705 - a) - 4.3711388e-8 : a, z = y * y;
  float p = 9.38540185543e-3;
  p = p * z + 3.11992232697e-3;
  p = p * z + 2.44301354525e-2;
  p = p * z + 5.34112807005e-2;
  p = p * z + 1.33387994085e-1;
  p = p * z + 3.33331568548e-1;
  float t = y + y * z * p;
  return sign(x) * (a > 0.7853981634 ? 1.0 / max(t, 1e-12) : t);
}

"""
)

_ANGLE = """\
// Return the angle of the point (x, y); x and y are not negative and not both 0.
float dsbrdf_angle(float y, float x) {
  float low = min(x, y), high = max(x, y);
  bool far = low > 0.4142135624 * high;
  float t = far ? (low - high) / (low + high) : low / high, z = t * t;
  float p = ((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1;
  float angle = (far ? 0.7853981634 : 0.0) + (t + t * z * p);
  return y > x ? 1.5707963268 - angle : angle;
}

"""

_ANGLES = """\
struct dsbrdf_Angles {
  float theta_diff;
  float squared;   // tan(theta_half)^2
  float cos2_phi;  // cos(phi_diff)^2
  float log_cos;   // log of the cosine that, to the power of the elongation, stretches lobes
  bool center;     // whether theta_half is small enough for the delta term
};

dsbrdf_Angles dsbrdf_angles(vec3 omega_in, vec3 omega_out) {
  dsbrdf_Angles angles;
  vec3 total = omega_in + omega_out, difference = omega_in - omega_out;
  float sum2 = max(dot(total, total), 1e-30), difference2 = dot(difference, difference);
  angles.theta_diff = dsbrdf_angle(sqrt(difference2), sqrt(sum2));

  // Project the half vector into the plane, and split the difference along and across the projection.
  float radius = length(total.xy);
  vec2 heading = radius > 0.0 ? total.xy / radius : vec2(1.0, 0.0);
  angles.squared = min((radius * radius) / max(total.z * total.z, 1e-30), 1e30);
  float along = (dot(heading, difference.xy) * total.z - radius * difference.z) / sqrt(sum2);
  float across = heading.x * difference.y - heading.y * difference.x;
  float length2 = along * along + across * across;
  angles.cos2_phi = length2 > 0.0 ? along * along / length2 : 1.0;

  float cos2_diff = sum2 / (sum2 + difference2);
  angles.log_cos = 0.25 * log(dsbrdf_GRAZING_FOURTH + (1.0 - dsbrdf_GRAZING_FOURTH) * cos2_diff * cos2_diff);
  angles.center = radius < dsbrdf_DELTA_TANGENT * total.z;
  return angles;
}

// Return tan(theta')^2, stretched by an elongation.
float dsbrdf_stretched(dsbrdf_Angles angles, float elongation) {
  float ratio = exp(elongation * angles.log_cos);
  return angles.squared * (angles.cos2_phi / ratio + (1.0 - angles.cos2_phi) * ratio);
}

"""

_ROWS = """
void dsbrdf_table_rows(float theta_diff, out float rows[COUNT]) {
  float held = clamp(theta_diff, FIRST, LAST);
  int piece = LATER;
  float start = dsbrdf_table_BREAKS[piece], t = (held - start) / (dsbrdf_table_BREAKS[piece + 1] - start), s = 1.0 - t;
  vec4 weights = vec4(s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t);
  for (int row = 0; row < COUNT; ++row) {
    rows[row] = dot(dsbrdf_table_TERMS[row * PIECES + piece], weights);
  }
}

"""

_LOBE = """\
// Return a lobe of height 1 at tan(theta')^2; a center above 0 is a ring, below 0 a cusp.
float dsbrdf_lobe(float squared, float kappa, float gamma, float center) {
  float top_tangent = 0.0;
  if (center != 0.0) {
    float root = sqrt(squared), tan_center = dsbrdf_tan(center);
    float tangent = (root - tan_center) / (1.0 + root * max(tan_center, 0.0));
    tangent = clamp(tangent, -1e12, 1e12);
    squared = tangent * tangent;
    top_tangent = min(tan_center, 0.0);
  }
  float top_squared = top_tangent * top_tangent;
FALL}

"""

# Statements that return a lobe of height 1, by lobe family.
_LOBE_BODIES = {
    "hemi_epd": """\
  float log_cos_top = -0.5 * dsbrdf_log1p(top_squared);
  float log_cos = -0.5 * dsbrdf_log1p(squared);
  float top = kappa * exp(gamma * log_cos_top);
  // This is expm1(top * ratio) / expm1(top) without overflow.
  float log_ratio = gamma * (log_cos - log_cos_top);
  return exp(top * dsbrdf_expm1(log_ratio)) * dsbrdf_expm1(-top * exp(log_ratio)) / dsbrdf_expm1(-top);
""",
    "student": """\
  return exp(-kappa * (dsbrdf_log1p(gamma * squared) - dsbrdf_log1p(gamma * top_squared)));
""",
}

_MODEL = """\
vec3 dsbrdf_model(dsbrdf_Angles angles) {
  float rows[COUNT];
  dsbrdf_rows(angles.theta_diff, rows);
  vec3 result = vec3(0.0), value;
  for (int lobe = 0; lobe < LOBES; ++lobe) {
    float squared = dsbrdf_stretched(angles, rows[ELONGATION + lobe]);
    for (int channel = 0; channel < SHAPES; ++channel) {
      int shape = channel * LOBES + lobe;
      value[channel] = dsbrdf_lobe(squared, EXP(rows[KAPPA + shape]), EXP(rows[GAMMA + shape]), CENTER);
    }
    result += HEIGHT(vec3(rows[lobe], rows[LOBES + lobe], rows[2 * LOBES + lobe])) * ALL;
  }
  if (angles.center) { DELTA }
  return result;
}

"""

_WHOLE = """\
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  return dsbrdf_model(dsbrdf_angles(omega_in, omega_out));
}
"""

_ONE_COMPONENT = """\
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  return dsbrdf_shown(omega_in, omega_out, vec3(WEIGHTS));
}
"""
