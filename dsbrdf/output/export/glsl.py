"""A model as a GLSL function, for a fragment shader: OpenGL ES 3.0 (WebGL 2), OpenGL 3.3 and later.

The parameters are cubic polynomials in theta_diff, a ``vec4`` each, in constant arrays of some kilobytes.  What single
precision would lose is kept: tangents come from the sum and the difference of the directions, the polynomials are in
Bernstein's form, in which nothing cancels, and ``log1p``, ``expm1``, ``tan`` and ``atan``, for which a shader's own
functions are too coarse, are spelled out; the last two are the rational reductions and polynomials of Cephes.
"""

import numpy as np

from dsbrdf.data.grid import CENTER_CUTOFF
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import GRAZING_COSINE
from dsbrdf.output.export.single_precision import bernstein_pieces
from dsbrdf.version import __version__


def glsl_function(model: DSBRDF) -> str:
    """Return GLSL source with ``vec3 dsbrdf(vec3 omega_in, vec3 omega_out)``.

    Parameters
    ----------
    model : DSBRDF

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
    pieces = bernstein_pieces(model, "GLSL")
    n_rows, n_pieces = pieces.coefficients.shape[:2]
    vectors = pieces.coefficients.reshape(-1, 4)
    constants = {
        "LOBES": model.n_lobes,
        "SHAPES": model.kappa.shape[0],
        "PIECES": n_pieces,
        "ROWS": n_rows,
        "SPLINE": int(model.interpolation == "spline"),
        "STUDENT": int(model.lobe == "student"),
    }
    defines = [f"const int DSBRDF_{name} = {value};" for name, value in constants.items()]
    defines += [
        f"const float DSBRDF_GRAZING_FOURTH = {_number(GRAZING_COSINE**4)};",
        f"const float DSBRDF_DELTA_TANGENT = {_number(float(np.tan(CENTER_CUTOFF)))};",
        f"const float DSBRDF_BREAKS[{n_pieces + 1}] = float[{n_pieces + 1}](",
        "  " + ", ".join(map(_number, pieces.breaks.tolist())) + ");",
        f"const vec4 DSBRDF_TERMS[{len(vectors)}] = vec4[{len(vectors)}](",
        ",\n".join("  vec4(" + ", ".join(map(_number, vector)) + ")" for vector in vectors.tolist()) + ");",
    ]
    return _HEADER.format(version=__version__) + "\n".join(defines) + _FUNCTIONS


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

_FUNCTIONS = """

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

float dsbrdf_row(int row, int piece, float t) {
  vec4 term = DSBRDF_TERMS[row * DSBRDF_PIECES + piece];
  float s = 1.0 - t;
  return s * s * (s * term.x + 3.0 * t * term.y) + t * t * (3.0 * s * term.z + t * term.w);
}

float dsbrdf_parameter(int row, int piece, float t) {
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
  if (DSBRDF_STUDENT == 1) {
    return exp(-kappa * (dsbrdf_log1p(gamma * squared) - dsbrdf_log1p(gamma * top_squared)));
  }
  float log_cos_top = -0.5 * dsbrdf_log1p(top_squared);
  float log_cos = -0.5 * dsbrdf_log1p(squared);
  float top = kappa * exp(gamma * log_cos_top);
  // expm1(top * ratio) / expm1(top), without overflow.
  float log_ratio = gamma * (log_cos - log_cos_top);
  return exp(top * dsbrdf_expm1(log_ratio)) * dsbrdf_expm1(-top * exp(log_ratio)) / dsbrdf_expm1(-top);
}

vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  vec3 total = omega_in + omega_out, difference = omega_in - omega_out;
  float sum2 = max(dot(total, total), 1e-30), difference2 = dot(difference, difference);
  float theta_diff = dsbrdf_angle(sqrt(difference2), sqrt(sum2));

  // The half vector in the plane, and the difference along and across its heading.
  float radius = length(total.xy);
  vec2 heading = radius > 0.0 ? total.xy / radius : vec2(1.0, 0.0);
  float squared = min((radius * radius) / max(total.z * total.z, 1e-30), 1e30);
  float along = (dot(heading, difference.xy) * total.z - radius * difference.z) / sqrt(sum2);
  float across = heading.x * difference.y - heading.y * difference.x;
  float length2 = along * along + across * across;
  float cos2_phi = length2 > 0.0 ? along * along / length2 : 1.0;

  float cos2_diff = sum2 / (sum2 + difference2);
  float log_cos = 0.25 * log(DSBRDF_GRAZING_FOURTH + (1.0 - DSBRDF_GRAZING_FOURTH) * cos2_diff * cos2_diff);

  float held = clamp(theta_diff, DSBRDF_BREAKS[0], DSBRDF_BREAKS[DSBRDF_PIECES]);
  int piece = 0;
  for (int i = 1; i < DSBRDF_PIECES; ++i) {
    if (held >= DSBRDF_BREAKS[i]) piece = i;
  }
  float at = (held - DSBRDF_BREAKS[piece]) / (DSBRDF_BREAKS[piece + 1] - DSBRDF_BREAKS[piece]);

  int kappa_row = 3 * DSBRDF_LOBES, count = DSBRDF_SHAPES * DSBRDF_LOBES;
  vec3 result = vec3(0.0);
  for (int lobe = 0; lobe < DSBRDF_LOBES; ++lobe) {
    float ratio = exp(dsbrdf_row(kappa_row + 3 * count + lobe, piece, at) * log_cos);
    float stretched = squared * (cos2_phi / ratio + (1.0 - cos2_phi) * ratio);
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
  if (radius < DSBRDF_DELTA_TANGENT * total.z) {
    for (int channel = 0; channel < 3; ++channel) {
      result[channel] += dsbrdf_row(DSBRDF_ROWS - 3 + channel, piece, at);
    }
  }
  return result;
}
"""
