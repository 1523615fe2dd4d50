//// header
// vec3 dsbrdf(vec3 omega_in, vec3 omega_out) is a measured BRDF as the sum of a few physical layers, without cosine,
// in 1/sr for linear red, green and blue. Directions are unit vectors away from the surface, in the frame whose z axis
// is the normal; below the horizon it is 0. Needs GLSL ES 3.00 (WebGL 2) or GLSL 3.30; mediump is too coarse.
precision highp float;

//// pair
struct dsbrdf_Pair {
  vec2 cosines; vec3 risen;           // cosines to the normal; rise of glass's reflectance there and at theta_diff
  float swing2, rise;                 // squared sine of theta_diff; 1 - cos(theta_diff)
  float sine2, tangent2, passed;      // squared sine, tangent of theta_half; log of the light that passes a surface
};

dsbrdf_Pair dsbrdf_pair(vec3 omega_in, vec3 omega_out) {
  dsbrdf_Pair p;
  vec3 total = omega_in + omega_out, difference = omega_in - omega_out;
  float total2 = max(dot(total, total), 1e-30), difference2 = dot(difference, difference);
  p.cosines = clamp(vec2(omega_in.z, omega_out.z), COSINE, 1.0);
  p.swing2 = difference2 / (total2 + difference2);
  p.rise = p.swing2 / (1.0 + sqrt(1.0 - p.swing2));
  vec3 cosine = vec3(p.cosines, 1.0 - p.rise), refracted = sqrt(1.25 + cosine * cosine);
  vec3 across = (refracted - cosine) / (refracted + cosine);
  vec3 ratio = (cosine * (refracted + cosine) - 1.0) / (cosine * (refracted - cosine) + 1.0);
  p.risen = max(0.5 * across * across * (1.0 + ratio * ratio) - COAT, 0.0) / (1.0 - COAT);
  p.passed = log((1.0 - p.risen.x) * (1.0 - p.risen.y));
  p.sine2 = min(dot(total.xy, total.xy) / total2, 1.0);
  p.tangent2 = min(dot(total.xy, total.xy) / max(total.z * total.z, 1e-30), TANGENT);
  return p;
}

//// surface
// Return log(D V), facets and masking; facets holds alpha, tail exponent (2 is GGX), norm of D, form of masking.
float dsbrdf_surface(dsbrdf_Pair p, float tangent2, vec4 facets) {
  float alpha2 = facets.x * facets.x, slope = tangent2 / (facets.z * alpha2);
  vec2 seen = sqrt(alpha2 + (1.0 - alpha2) * p.cosines * p.cosines), apart = p.cosines + seen;
  float together = dot(p.cosines.yx, seen);
  return facets.w * log(2.0 * together / (apart.x * apart.y)) - log(6.2831853 * alpha2 * together)
    + 2.0 * log(1.0 + tangent2) - facets.y * log(1.0 + slope);
}

//// SpecularLayer
// bend holds two exponents for reflectance unlike glass, and 1 for a surface below a clear coat.
vec3 dsbrdf_specular(dsbrdf_Pair p, vec3 f0, float f90, vec4 facets, vec3 bend) {
  float bent = dot(bend, vec3(p.rise, p.rise * p.rise, p.passed - CLEAR));
  return log(mix(f0, vec3(f90), p.risen.z)) + (dsbrdf_surface(p, p.tangent2, facets) + bent);
}

//// RetroLayer
// Light returns to its source: theta_half is computed with omega_in turned by 180 degrees.
vec3 dsbrdf_retro(dsbrdf_Pair p, vec3 color, vec4 facets) {
  float height = p.cosines.x + p.cosines.y, step = p.cosines.x - p.cosines.y;
  float tangent2 = max(4.0 * p.swing2 - step * step, 0.0) / (height * height);
  return log(color) + dsbrdf_surface(p, tangent2, facets);
}

//// DiffuseLayer
// first holds the exponents of passed light, retro-reflection and rise; second: limb, theta_half, Oren and Nayar.
vec3 dsbrdf_diffuse(dsbrdf_Pair p, vec3 albedo, vec3 first, vec3 second) {
  float limb = log(2.0 / (p.cosines.x + p.cosines.y)), along = 1.0 - 2.0 * p.swing2 - p.cosines.x * p.cosines.y;
  if (along > 0.0) along /= max(p.cosines.x, p.cosines.y);
  vec3 ground = vec3(p.passed, (1.0 - p.swing2) * (p.risen.x + p.risen.y), p.risen.z);
  return log(albedo / 3.14159265) + (dot(first, ground) + dot(second, vec3(limb, p.sine2, along)));
}

//// SheenLayer
// Fibres scatter light at grazing angles, with powers of 1 - cos(theta_diff) and of sin(theta_half).
vec3 dsbrdf_sheen(dsbrdf_Pair p, vec3 color, vec2 powers) {
  return log(color) + dot(powers, log(vec2(max(p.rise, RISE), sqrt(max(p.sine2, SINE2)))));
}

//// layered
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  dsbrdf_Pair p = dsbrdf_pair(omega_in, omega_out);
  return TERMS;
}
//// only component
vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  return shown.SHOWN * dsbrdf_model(dsbrdf_angles(omega_in, omega_out));
}

//// division of model
// Return log(exp(first) + exp(second)) without overflow.
vec3 dsbrdf_both(vec3 first, vec3 second) {
  vec3 top = max(first, second);
  return top + log(exp(first - top) + exp(second - top));
}

// Divide the model into specular spike, specular lobe and diffuse part, by the logarithms of their layers.
mat3 dsbrdf_divided(float tangent2, vec3 whole, vec3 narrow, vec3 wide, vec3 diffuse) {
  vec3 specular = dsbrdf_both(narrow, wide), odds = exp(clamp(specular - diffuse, -60.0, 60.0));
  vec3 s = 1.0 / (1.0 + odds), ground = exp(diffuse), missed = whole - exp(specular) - ground;
  float q = tangent2 / HALO, core = CORE * q;
  vec3 scaled = q * mix(vec3(NEAR), vec3(1.0), vec3(greaterThan(missed, vec3(0.0))));
  vec3 halo = 1.0 / (1.0 + scaled * scaled), beyond = 1.0 - halo, taken = beyond * s * s * s;
  vec3 highlight = whole + missed * beyond * s * (1.0 + s * (1.0 + s));
  vec3 rest = max(odds * s * highlight + missed * halo * s, 0.0), v = exp(wide - specular);
  vec3 spike = exp(narrow - specular) * (rest * (1.0 + v) * (1.0 + v * v) - exp(wide) * (1.0 + v * (1.0 + v)));
  spike = clamp(mix(spike, rest - exp(wide), 1.0 / (1.0 + core * core)), vec3(0.0), rest);
  return mat3(spike, rest - spike, min(whole, ground * (1.0 - taken) + whole * taken * s));
}

// Divide the model if the layers are only a ground: much brighter light near the mirror direction is a highlight.
mat3 dsbrdf_ground(float tangent2, vec3 whole, vec3 diffuse) {
  float q = tangent2 / HALO;
  vec3 ground = min(whole, exp(diffuse) * (2.0 + q * q));
  return mat3(vec3(0.0), whole - ground, ground);
}

vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  vec3 whole = dsbrdf_model(dsbrdf_angles(omega_in, omega_out));
  dsbrdf_Pair p = dsbrdf_pair(omega_in, omega_out);
  // The mean over the structures of layers that explain the model.
  mat3 parts = PARTS;
  return parts * vec3(RECEIVERS);
}

