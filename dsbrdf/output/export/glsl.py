"""A model as a GLSL function, for a fragment shader: OpenGL ES 3.0 (WebGL 2), OpenGL 3.3 and later.

The parameters are cubic polynomials in theta_diff, a ``vec4`` each, in constant arrays of some kilobytes.  What single
precision would lose is kept: tangents come from the sum and the difference of the directions, the polynomials are in
Bernstein's form, in which nothing cancels, and ``log1p``, ``expm1``, ``tan`` and ``atan``, for which a shader's own
functions are too coarse, are spelled out; the last two are the rational reductions and polynomials of Cephes.

A component's function evaluates the model and the readable lobes once and divides the model as
`dsbrdf.fitting.decomposition` does, with the formula turned so that hardly a difference of nearly equal numbers is
left: with s the diffuse share of the readable lobes, their sum g, and a = q / (1 + q),

    diffuse = min(f, g_d (1 - a s**3) + f a s**4),
    specular = max(0, (1 - s) (f + (f - g) a (s + s**2 + s**3)) + (f - g) (1 - a) s).

The shares come from the logarithms of the lobes, relative to the largest: far from the highlight all may underflow.
"""

import numpy as np

from dsbrdf.data.grid import CENTER_CUTOFF
from dsbrdf.fitting.decomposition import HALO, LABELS, Component
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobe_families import FAMILIES
from dsbrdf.model.lobes import GRAZING_COSINE
from dsbrdf.output.export.single_precision import bernstein_pieces
from dsbrdf.version import __version__


def glsl_function(model: DSBRDF | Component) -> str:
    """Return GLSL source with ``vec3 dsbrdf(vec3 omega_in, vec3 omega_out)``.

    Parameters
    ----------
    model : DSBRDF or Component
        The source for a component also has ``vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown)``: all
        components of its model, times the weights ``shown`` of specular spike, specular lobe and diffuse.

    Returns
    -------
    str
        The function returns the BRDF, without the cosine, in 1/sr; the directions are unit vectors in the frame whose
        z axis is the normal.  Every name in the source begins with ``dsbrdf`` or ``DSBRDF``.

    Raises
    ------
    InvalidArgumentError
        If a parameter is too large for single precision.
    """
    header = _HEADER.format(version=__version__)
    if isinstance(model, DSBRDF):
        return header + _CONSTANTS + _MATH + _model(model) + _WHOLE
    guide, labels = model.whole.guide, model.whole.labels
    places = ", ".join(str(LABELS.index(label)) for label in labels)
    weights = ", ".join(f"{float(label == model.label)}" for label in LABELS)
    lobes = [
        f"const int DSBRDF_GUIDE_LOBES = {len(labels)};",
        f"const int DSBRDF_GUIDE_PLACES[{len(labels)}] = int[{len(labels)}]({places});",
    ]
    return (
        header
        + _HEADER_OF_COMPONENT.format(label=model.label.replace("_", " "))
        + _CONSTANTS
        + _MATH
        + _model(model.whole.model)
        + "\n".join(lobes)
        + _table(guide, "_guide")
        + _SHARES
        + _ONE_COMPONENT.format(weights=weights)
    )


def _model(model: DSBRDF) -> str:
    """Return ``vec3 dsbrdf_model(dsbrdf_Angles angles)`` with its constants."""
    constants = {
        "LOBES": model.n_lobes,
        "SHAPES": model.kappa.shape[0],
        "SPLINE": int(model.interpolation == "spline"),
    }
    defines = [f"const int DSBRDF_{name} = {value};" for name, value in constants.items()]
    return "\n".join(defines) + _table(model, "") + _LOBES.replace("DSBRDF_FALL", FAMILIES[model.lobe].glsl)


def _table(model: DSBRDF, name: str) -> str:
    """Return the rows of parameters of a model as constants, and ``float dsbrdf{name}_row(int, int, float)``."""
    pieces = bernstein_pieces(model, "GLSL")
    n_rows, n_pieces = pieces.coefficients.shape[:2]
    vectors = pieces.coefficients.reshape(-1, 4)
    prefix = f"DSBRDF{name.upper()}"
    constants = [
        f"\nconst int {prefix}_PIECES = {n_pieces};",
        f"const int {prefix}_ROWS = {n_rows};",
        f"const float {prefix}_BREAKS[{n_pieces + 1}] = float[{n_pieces + 1}](",
        "  " + ", ".join(map(_number, pieces.breaks.tolist())) + ");",
        f"const vec4 {prefix}_TERMS[{len(vectors)}] = vec4[{len(vectors)}](",
        ",\n".join("  vec4(" + ", ".join(map(_number, vector)) + ")" for vector in vectors.tolist()) + ");",
    ]
    functions = _ROW.replace("dsbrdf_table", f"dsbrdf{name}").replace("DSBRDF_TABLE", prefix)
    return "\n".join(constants) + functions


def _number(value: float) -> str:
    text = repr(float(np.float32(value))) if abs(value) > 1e-37 else "0.0"
    return text if "." in text or "e" in text else text + ".0"


_HEADER = """\
// A measured BRDF as a function: Directional Statistics BRDF model, written by dsbrdf {version}.
//
//   vec3 dsbrdf(vec3 omega_in, vec3 omega_out)
//
// returns the BRDF in 1/sr for red, green and blue (linear), without the cosine. The directions point away from the
// surface; they are unit vectors in the frame whose z axis is the normal. Below the horizon it is 0.
// Needs GLSL ES 3.00 (WebGL 2) or GLSL 3.30, and "precision highp float;" in ES.

"""

_HEADER_OF_COMPONENT = """\
// This is a component, the {label}: its share of the values of the whole material.
//
//   vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown)
//
// returns all components, times their weights: shown.x of the specular spike, shown.y of the specular lobe, shown.z of
// the diffuse part. A component that the material does not have is 0. With vec3(1.0) it is the whole material.

"""

_CONSTANTS = f"""\
const float DSBRDF_GRAZING_FOURTH = {_number(GRAZING_COSINE**4)};
const float DSBRDF_DELTA_TANGENT = {_number(float(np.tan(CENTER_CUTOFF)))};
const float DSBRDF_HALO = {_number(HALO)};
"""
_MATH = """
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

// Angle of the point (x, y), both zero or positive and not both zero.
float dsbrdf_angle(float y, float x) {
  float low = min(x, y), high = max(x, y);
  bool far = low > 0.4142135624 * high;
  float t = far ? (low - high) / (low + high) : low / high, z = t * t;
  float p = ((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1;
  float angle = (far ? 0.7853981634 : 0.0) + (t + t * z * p);
  return y > x ? 1.5707963268 - angle : angle;
}

struct dsbrdf_Angles {
  float theta_diff;
  float squared;   // tan(theta_half)^2
  float cos2_phi;  // cos(phi_diff)^2
  float log_cos;   // logarithm of the cosine that stretches lobes
  bool center;     // so near the normal that the delta term counts
};

dsbrdf_Angles dsbrdf_angles(vec3 omega_in, vec3 omega_out) {
  dsbrdf_Angles angles;
  vec3 total = omega_in + omega_out, difference = omega_in - omega_out;
  float sum2 = max(dot(total, total), 1e-30), difference2 = dot(difference, difference);
  angles.theta_diff = dsbrdf_angle(sqrt(difference2), sqrt(sum2));

  // The half vector in the plane, and the difference along and across its heading.
  float radius = length(total.xy);
  vec2 heading = radius > 0.0 ? total.xy / radius : vec2(1.0, 0.0);
  angles.squared = min((radius * radius) / max(total.z * total.z, 1e-30), 1e30);
  float along = (dot(heading, difference.xy) * total.z - radius * difference.z) / sqrt(sum2);
  float across = heading.x * difference.y - heading.y * difference.x;
  float length2 = along * along + across * across;
  angles.cos2_phi = length2 > 0.0 ? along * along / length2 : 1.0;

  float cos2_diff = sum2 / (sum2 + difference2);
  angles.log_cos = 0.25 * log(DSBRDF_GRAZING_FOURTH + (1.0 - DSBRDF_GRAZING_FOURTH) * cos2_diff * cos2_diff);
  angles.center = radius < DSBRDF_DELTA_TANGENT * total.z;
  return angles;
}

// tan(theta')^2: stretched by an elongation.
float dsbrdf_stretched(dsbrdf_Angles angles, float elongation) {
  float ratio = exp(elongation * angles.log_cos);
  return angles.squared * (angles.cos2_phi / ratio + (1.0 - angles.cos2_phi) * ratio);
}

"""

_ROW = """

// The piece of theta_diff, and how far in it.
int dsbrdf_table_piece(float theta_diff, out float at) {
  float held = clamp(theta_diff, DSBRDF_TABLE_BREAKS[0], DSBRDF_TABLE_BREAKS[DSBRDF_TABLE_PIECES]);
  int piece = 0;
  for (int i = 1; i < DSBRDF_TABLE_PIECES; ++i) {
    if (held >= DSBRDF_TABLE_BREAKS[i]) piece = i;
  }
  at = (held - DSBRDF_TABLE_BREAKS[piece]) / (DSBRDF_TABLE_BREAKS[piece + 1] - DSBRDF_TABLE_BREAKS[piece]);
  return piece;
}

float dsbrdf_table_row(int row, int piece, float t) {
  vec4 term = DSBRDF_TABLE_TERMS[row * DSBRDF_TABLE_PIECES + piece];
  float s = 1.0 - t;
  return s * s * (s * term.x + 3.0 * t * term.y) + t * t * (3.0 * s * term.z + t * term.w);
}

"""

_LOBES = """float dsbrdf_parameter(int row, int piece, float t) {
  float value = dsbrdf_row(row, piece, t);
  return DSBRDF_SPLINE == 1 ? exp(value) : value;
}

// A lobe of height 1, of tan(theta')^2; a center above 0 is a ring, below 0 a cusp.
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
DSBRDF_FALL}

vec3 dsbrdf_model(dsbrdf_Angles angles) {
  float at;
  int piece = dsbrdf_piece(angles.theta_diff, at);
  int kappa_row = 3 * DSBRDF_LOBES, count = DSBRDF_SHAPES * DSBRDF_LOBES;
  vec3 result = vec3(0.0);
  for (int lobe = 0; lobe < DSBRDF_LOBES; ++lobe) {
    float stretched = dsbrdf_stretched(angles, dsbrdf_row(kappa_row + 3 * count + lobe, piece, at));
    float value = 0.0;
    for (int channel = 0; channel < 3; ++channel) {
      if (channel < DSBRDF_SHAPES) {
        int row = kappa_row + channel * DSBRDF_LOBES + lobe;
        float kappa = dsbrdf_parameter(row, piece, at);
        float gamma = dsbrdf_parameter(row + count, piece, at);
        value = dsbrdf_lobe(stretched, kappa, gamma, dsbrdf_row(row + 2 * count, piece, at));
      }
      float height = dsbrdf_row(channel * DSBRDF_LOBES + lobe, piece, at);
      result[channel] += (DSBRDF_SPLINE == 1 ? exp(height) : dsbrdf_expm1(height)) * value;
    }
  }
  if (angles.center) {
    for (int channel = 0; channel < 3; ++channel) {
      result[channel] += dsbrdf_row(DSBRDF_ROWS - 3 + channel, piece, at);
    }
  }
  return result;
}

"""

_WHOLE = """\
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  return dsbrdf_model(dsbrdf_angles(omega_in, omega_out));
}
"""

# The readable lobes are Student's t over slopes about the normal, their rows logarithms: so is the value.
_SHARES = """\
// The logarithm of a readable lobe.
vec3 dsbrdf_guide_log(dsbrdf_Angles angles, int lobe) {
  float at;
  int piece = dsbrdf_guide_piece(angles.theta_diff, at), count = DSBRDF_GUIDE_LOBES;
  float stretched = dsbrdf_stretched(angles, dsbrdf_guide_row(6 * count + lobe, piece, at));
  float kappa = exp(dsbrdf_guide_row(3 * count + lobe, piece, at));
  float gamma = exp(dsbrdf_guide_row(4 * count + lobe, piece, at));
  vec3 height;
  for (int channel = 0; channel < 3; ++channel) {
    height[channel] = dsbrdf_guide_row(channel * count + lobe, piece, at);
  }
  return height - kappa * dsbrdf_log1p(gamma * stretched);
}

vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  dsbrdf_Angles angles = dsbrdf_angles(omega_in, omega_out);
  vec3 whole = dsbrdf_model(angles);
  vec3 guide[3] = vec3[3](vec3(-1e30), vec3(-1e30), vec3(-1e30));  // of a lobe that is not there: never the largest
  for (int lobe = 0; lobe < DSBRDF_GUIDE_LOBES; ++lobe) {
    guide[DSBRDF_GUIDE_PLACES[lobe]] = dsbrdf_guide_log(angles, lobe);
  }
  vec3 top = max(guide[0], max(guide[1], guide[2]));
  vec3 spike = exp(guide[0] - top), wide = exp(guide[1] - top), diffuse = exp(guide[2] - top);
  vec3 specular = spike + wide, total = specular + diffuse;

  float q = angles.squared / DSBRDF_HALO, halo = 1.0 / (1.0 + q * q);
  vec3 s = diffuse / total, taken = (1.0 - halo) * s * s * s;
  vec3 own = min(whole, exp(guide[2]) * (1.0 - taken) + whole * taken * s);
  vec3 missed = whole - total * exp(top);
  vec3 highlight = whole + missed * (1.0 - halo) * s * (1.0 + s * (1.0 + s));
  vec3 rest = max(specular / total * highlight + missed * halo * s, 0.0);
  vec3 divided = rest / max(specular, 1e-30);
  return shown.x * divided * spike + shown.y * divided * wide + shown.z * own;
}

"""

_ONE_COMPONENT = """\
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {{
  return dsbrdf_shown(omega_in, omega_out, vec3({weights}));
}}
"""
