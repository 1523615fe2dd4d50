"""Values of a model in GLSL: its parameters in a constant array, and the mathematics they need.

One loop looks all parameters up, and one takes the lobes in turn: some compilers copy a constant array wherever it is
indexed, and functions wherever they are called.
"""

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.grid import CENTER_CUTOFF
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobe_families import FAMILIES
from dsbrdf.model.lobes import GRAZING_COSINE
from dsbrdf.output.export.single_precision import bernstein_pieces


def model_function(model: DSBRDF) -> str:
    """Return ``vec3 dsbrdf_model(dsbrdf_Angles angles)``, and what it needs beyond `MATH`."""
    exp, height = ("exp", "exp") if model.interpolation == "spline" else ("", "dsbrdf_expm1")
    lobes, shapes = model.n_lobes, model.kappa.shape[0]
    rows, count = parameter_rows(model, "dsbrdf")
    centers, delta = 4 * lobes + 2 * shapes * lobes, "result += vec3({0}[{1}], {0}[{2}], {0}[{3}]);"
    text = _LOBE.replace("FALL", FAMILIES[model.lobe].glsl) + _MODEL
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
    return rows + _filled(text, words)


def parameter_rows(model: DSBRDF, table: str) -> tuple[str, int]:
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
    later = " + ".join(f"int(held >= {number(at)})" for at in breaks[1:-1].tolist()) or "0"
    ends = {"FIRST": number(breaks[0]), "LAST": number(breaks[-1]), "LATER": later}
    functions = _filled(_ROWS, ends | {"PIECES": breaks.size - 1, "COUNT": len(coefficients)})
    constants = array("float", "dsbrdf_table_BREAKS", breaks[:, np.newaxis])
    constants += array("vec4", "dsbrdf_table_TERMS", coefficients.reshape(-1, 4))
    return (constants + functions).replace("dsbrdf_table", table), len(coefficients)


def _filled(text: str, words: dict[str, str | int]) -> str:
    for word, value in words.items():
        text = text.replace(word, str(value))
    return text


def array(kind: str, name: str, values: Array) -> str:
    """Return a constant array of numbers or vectors (n, k)."""
    items = (f"{kind}({', '.join(map(number, row))})" for row in values.tolist())
    return f"const {kind} {name}[{len(values)}] = {kind}[{len(values)}](\n  " + ",\n  ".join(items) + ");\n"


def constant(name: str, value: float) -> str:
    """Return a constant number."""
    return f"const float dsbrdf_{name} = {number(value)};\n"


def number(value: float) -> str:
    """Return a number in single precision."""
    text = repr(float(np.float32(value))) if abs(value) > 1e-37 else "0.0"
    return text if "." in text or "e" in text else text + ".0"


MATH = (
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
  angles.log_cos = 0.25 * log(dsbrdf_GRAZING_FOURTH + (1.0 - dsbrdf_GRAZING_FOURTH) * cos2_diff * cos2_diff);
  angles.center = radius < dsbrdf_DELTA_TANGENT * total.z;
  return angles;
}

// tan(theta')^2: stretched by an elongation.
float dsbrdf_stretched(dsbrdf_Angles angles, float elongation) {
  float ratio = exp(elongation * angles.log_cos);
  return angles.squared * (angles.cos2_phi / ratio + (1.0 - angles.cos2_phi) * ratio);
}

"""
)


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
FALL}

"""

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
