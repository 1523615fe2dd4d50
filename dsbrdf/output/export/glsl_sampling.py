"""Write sampling functions in GLSL, with the formulas and names of `dsbrdf.model.sampling`."""

import numpy as np

from dsbrdf.model.sampling import ANGLES, DirectionSampler
from dsbrdf.output.export.single_precision import constant, constant_array

HEADER_OF_SAMPLING = """\
//   vec3 dsbrdf_sample(vec3 omega_out, vec3 random)
//   float dsbrdf_pdf(vec3 omega_in, vec3 omega_out)
//
// draw a direction omega_in with three independent numbers from 0 to 1, and return its density in 1/sr: the weight of
// a sample is dsbrdf(omega_in, omega_out) * omega_in.z / dsbrdf_pdf(omega_in, omega_out). Some samples at grazing
// angles are below the horizon; their density is 0, and the samples are black.
//
"""

_SAMPLING = """
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
"""


def sampling_functions(sampler: DirectionSampler) -> str:
    """Return ``vec3 dsbrdf_sample(vec3, vec3)`` and ``float dsbrdf_pdf(vec3, vec3)``; they need ``dsbrdf_angle``."""
    share = np.diff(sampler.cumulative, axis=1, prepend=0.0)[:, :-1]
    parts = np.stack([sampler.along, sampler.across, share], axis=-1)
    text = _SAMPLING.replace("PARTS", str(parts.shape[1])).replace("LAST", str(ANGLES.size - 1))
    return (
        "\n"
        + constant("STEP", float(ANGLES[1]))
        + constant_array("vec3", "dsbrdf_MIXTURE", parts.reshape(-1, 3))
        + text
    )
