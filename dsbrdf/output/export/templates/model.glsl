//// header
// A measured BRDF as a function: Directional Statistics BRDF model.
//
//   vec3 dsbrdf(vec3 omega_in, vec3 omega_out)
//
// returns the BRDF in 1/sr for red, green and blue (linear), without the cosine. Below the horizon it is 0.
//
//// frame
// Directions point away from the surface; they are unit vectors in the frame whose z axis is the normal.
//
//// header of component
// This is a component of the material, the LABEL.
//
//   vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown)
//
// returns the weighted sum of all components; the weights are shown.x for the specular spike, shown.y for the specular
// lobe and shown.z for the diffuse part. An absent component is 0. With vec3(1.0), the sum is the whole material.
//
//// precision
// Needs GLSL ES 3.00 (WebGL 2) or GLSL 3.30. WARNING: mediump, which may be 16 bits, is too coarse: the highlight would
// be wrong or missing. The two lines below set highp from here on; pass directions that were computed in highp.
#ifdef GL_ES
precision highp float;
precision highp int;
#endif

//// math

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

//// angle
// Return the angle of the point (x, y); x and y are not negative and not both 0.
float dsbrdf_angle(float y, float x) {
  float low = min(x, y), high = max(x, y);
  bool far = low > 0.4142135624 * high;
  float t = far ? (low - high) / (low + high) : low / high, z = t * t;
  float p = ((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1;
  float angle = (far ? 0.7853981634 : 0.0) + (t + t * z * p);
  return y > x ? 1.5707963268 - angle : angle;
}

//// angles
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

//// rows

void dsbrdf_rows(float theta_diff, out float rows[COUNT]) {
  float held = clamp(theta_diff, FIRST, LAST);
  int piece = LATER;
  float start = dsbrdf_BREAKS[piece], t = (held - start) / (dsbrdf_BREAKS[piece + 1] - start), s = 1.0 - t;
  vec4 weights = vec4(s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t);
  for (int row = 0; row < COUNT; ++row) {
    rows[row] = dot(dsbrdf_TERMS[row * PIECES + piece], weights);
  }
}

//// lobe
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

//// hemi_epd
  float log_cos_top = -0.5 * dsbrdf_log1p(top_squared);
  float log_cos = -0.5 * dsbrdf_log1p(squared);
  float top = kappa * exp(gamma * log_cos_top);
  // This is expm1(top * ratio) / expm1(top) without overflow.
  float log_ratio = gamma * (log_cos - log_cos_top);
  return exp(top * dsbrdf_expm1(log_ratio)) * dsbrdf_expm1(-top * exp(log_ratio)) / dsbrdf_expm1(-top);
//// student
  return exp(-kappa * (dsbrdf_log1p(gamma * squared) - dsbrdf_log1p(gamma * top_squared)));
//// model
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

//// whole
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  return dsbrdf_model(dsbrdf_angles(omega_in, omega_out));
}
//// one component
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  return dsbrdf_shown(omega_in, omega_out, vec3(WEIGHTS));
}
//// header of sampling
//   vec3 dsbrdf_sample(vec3 omega_out, vec3 random)
//   float dsbrdf_pdf(vec3 omega_in, vec3 omega_out)
//
// draw a direction omega_in with three independent numbers from 0 to 1, and return its density in 1/sr: the weight of
// a sample is dsbrdf(omega_in, omega_out) * omega_in.z / dsbrdf_pdf(omega_in, omega_out). Some samples at grazing
// angles are below the horizon; their density is 0, and the samples are black.
//
//// sampling

// Return the index of the first part of the mixture for a direction.
int dsbrdf_mixture(vec3 omega_out) {
  return PARTS * clamp(int(dsbrdf_angle(length(omega_out.xy), omega_out.z) / dsbrdf_STEP + 0.5), 0, LAST);
}

vec2 dsbrdf_heading(vec3 omega_out) {
  float radius = length(omega_out.xy);
  return radius > 0.0 ? omega_out.xy / radius : vec2(1.0, 0.0);
}

vec3 dsbrdf_sample(vec3 omega_out, vec3 random) {
  int first = dsbrdf_mixture(omega_out);
  vec2 heading = dsbrdf_heading(omega_out);
  vec2 turn = vec2(cos(6.2831853 * random.z), sin(6.2831853 * random.z));
  turn /= length(turn);  // A shader's cosine and sine may have errors of 1e-3.
  for (int i = 0; i < PARTS; ++i) {
    vec3 part = dsbrdf_MIXTURE[first + i];
    if (random.x < part.z) {  // Mirror omega_out at a normal visible from it.
      vec2 seen = vec2(part.x * length(omega_out.xy), omega_out.z);
      seen /= length(seen);
      float z = (1.0 - random.y) * (1.0 + seen.y) - seen.y, radius = sqrt(max(1.0 - z * z, 0.0));
      float toward = part.x * (radius * turn.x + seen.x), aside = part.y * radius * turn.y;
      vec3 normal = vec3(toward * heading + aside * vec2(-heading.y, heading.x), z + seen.y);
      return 2.0 * dot(normal, omega_out) / dot(normal, normal) * normal - omega_out;
    }
    random.x -= part.z;
  }
  return vec3(sqrt(random.y) * turn, sqrt(max(1.0 - random.y, 0.0)));
}

float dsbrdf_pdf(vec3 omega_in, vec3 omega_out) {
  if (omega_in.z <= 0.0 || omega_out.z <= 0.0) return 0.0;
  int first = dsbrdf_mixture(omega_out);
  vec2 heading = dsbrdf_heading(omega_out);
  vec3 total = omega_in + omega_out;
  float toward = dot(heading, total.xy), aside = heading.x * total.y - heading.y * total.x;
  float mirrored = 0.0, cosine_share = 1.0;
  for (int i = 0; i < PARTS; ++i) {
    vec3 part = dsbrdf_MIXTURE[first + i];
    float along = toward / part.x, across = aside / part.y, stretched = part.x * length(omega_out.xy);
    float slopes = dot(total, total) / (total.z * total.z + along * along + across * across);
    float visible = omega_out.z + sqrt(omega_out.z * omega_out.z + stretched * stretched);
    mirrored += part.z * slopes * slopes / (part.x * part.y * visible);
    cosine_share -= part.z;
  }
  return mirrored / 6.2831853 + cosine_share * omega_in.z / 3.14159265;
}
