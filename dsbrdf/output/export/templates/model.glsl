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

float dsbrdf_arctan(float x) {
  return dsbrdf_angle(x, 1.0);
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

vec3 dsbrdf_sample(vec3 omega_out, vec3 random) {
  int first = dsbrdf_mixture(omega_out);
  vec2 turn = vec2(cos(6.2831853 * random.z), sin(6.2831853 * random.z));
  turn /= length(turn);  // A shader's cosine and sine may have errors of 1e-3.
  for (int i = 0; i < PARTS; ++i) {
    vec3 part = dsbrdf_MIXTURE[first + i];
    if (random.x < part.z) return dsbrdf_mirrored(omega_out, part, vec3(random.y, turn));
    random.x -= part.z;
  }
  return vec3(sqrt(random.y) * turn, sqrt(max(1.0 - random.y, 0.0)));
}

float dsbrdf_pdf(vec3 omega_in, vec3 omega_out) {
  if (omega_in.z <= 0.0 || omega_out.z <= 0.0) return 0.0;
  int first = dsbrdf_mixture(omega_out);
  float mirrored = 0.0, cosine_fraction = 1.0;
  for (int i = 0; i < PARTS; ++i) {
    vec3 part = dsbrdf_MIXTURE[first + i];
    mirrored += part.z * dsbrdf_mirrored_density(omega_in, omega_out, part);
    cosine_fraction -= part.z;
  }
  return mirrored + cosine_fraction * omega_in.z / 3.14159265;
}
