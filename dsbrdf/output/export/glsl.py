"""A model as a GLSL function, for a fragment shader: OpenGL ES 3.0 (WebGL 2), OpenGL 3.3 and later.

In the templates, ``dsbrdf`` stands for the name of the function.

The parameters are cubic polynomials in theta_diff, a ``vec4`` each, in constant arrays of some kilobytes. What single
precision would lose is kept: tangents come from the sum and the difference of the directions, the polynomials are in
Bernstein's form, in which nothing cancels, and ``log1p``, ``expm1``, ``tan`` and ``atan``, for which a shader's own
functions are too coarse, are spelled out; the last two are the rational reductions and polynomials of Cephes.

A component's function evaluates the model and the readable lobes once and divides the model as
`dsbrdf.fitting.decomposition` does, with the formula turned so that hardly a difference of nearly equal numbers is
left: with s the diffuse share of the readable lobes, their sum g, and a = q / (1 + q),

    diffuse = min(f, g_d (1 - a s**3) + f a s**4),
    specular = max(0, (1 - s) (f + (f - g) a (s + s**2 + s**3)) + (f - g) (1 - a) s).

The shares come from the logarithms of the lobes, relative to the largest: far from the highlight all may underflow.

Formulas and names of the sampling are those of `dsbrdf.model.sampling`.
"""

import re

import numpy as np

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.decomposition import HALO, LABELS, Component
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.sampling import ANGLES, DirectionSampler, direction_sampler
from dsbrdf.output.export.glsl_model import MATH, array, constant, model_function, parameter_rows
from dsbrdf.version import __version__

NAME = "dsbrdf"
"""Name of the function where no other is given."""
_NAME = r"(?!gl_)[A-Za-z](_?[A-Za-z0-9]){0,63}"
_WORDS = (
    " active asm attribute buffer case cast centroid class coherent common const continue default discard do double "
    "else enum extern external false filter fixed flat float for goto half highp if in inline inout input int "
    "interface invariant layout long lowp main mediump namespace noinline noperspective out output packed partition "
    "patch precise precision public readonly resource restrict return sample shared short sizeof smooth static struct "
    "subroutine superp switch template this true typedef uint uniform union unsigned using varying void volatile "
    "while writeonly abs acos acosh all any asin asinh atan atanh bool ceil clamp cos cosh cross degrees determinant "
    "distance dot equal exp floor fract inverse isinf isnan length log max min mix mod modf normalize not pow radians "
    "reflect refract round sign sin sinh sqrt step tan tanh texture transpose trunc "
)


def glsl_function(source: DSBRDF | Component, name: str = NAME, *, sampling: bool = False) -> str:
    """Return GLSL source with ``vec3 dsbrdf(vec3 omega_in, vec3 omega_out)``.

    Parameters
    ----------
    source : DSBRDF or Component
        The source for a component also has ``vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown)``: all
        components of its model, times the weights ``shown`` of specular spike, specular lobe and diffuse.
    name : str, optional
        Takes the place of ``dsbrdf``. Every name in the source begins with it, so that a program can hold several.
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
    if not re.fullmatch(_NAME, name) or f" {name} " in _WORDS:
        raise InvalidArgumentError(
            "the name of a GLSL function must begin with a letter, have at most 64 letters and digits with single "
            f"underscores between them, and be no word of GLSL, unlike {name!r}"
        )
    parts = [_HEADER, _HEADER_OF_SAMPLING if sampling else "", _FRAME]
    if isinstance(source, DSBRDF):
        parts += [_PRECISION, MATH, model_function(source), _WHOLE]
    else:
        weights = ", ".join(f"{float(label == source.label)}" for label in LABELS)
        parts += [_HEADER_OF_COMPONENT.replace("LABEL", source.label.replace("_", " ")), _PRECISION, MATH]
        parts += [model_function(source.whole.model), _shares(source), _ONE_COMPONENT.replace("WEIGHTS", weights)]
    if sampling:
        sampler = source.sampler if isinstance(source, DSBRDF) else direction_sampler(source.evaluate_unmasked)
        parts.append(_sampling_functions(sampler))
    return f"// Written by dsbrdf {__version__}.\n" + "".join(parts).replace("dsbrdf", name)


def _shares(component: Component) -> str:
    """Return ``dsbrdf_shown``; the readable lobes are Student's t over slopes, and their rows logarithms."""
    labels = component.whole.labels
    rows, count = parameter_rows(component.whole.guide, "dsbrdf_guide")
    places = f"int[{len(labels)}]({', '.join(str(LABELS.index(label)) for label in labels)})"
    text = _SHARES.replace("COUNT", str(count)).replace("PLACES", places).replace("LOBES", str(len(labels)))
    return constant("HALO", HALO) + rows + text


def _sampling_functions(sampler: DirectionSampler) -> str:
    """Return ``vec3 dsbrdf_sample(vec3, vec3)`` and ``float dsbrdf_pdf(vec3, vec3)``; see `dsbrdf_angle` of `MATH`."""
    share = np.diff(sampler.cumulative, axis=1, prepend=0.0)[:, :-1]
    parts = np.stack([sampler.along, sampler.across, share], axis=-1)
    text = _SAMPLING.replace("PARTS", str(parts.shape[1])).replace("LAST", str(ANGLES.size - 1))
    return "\n" + constant("STEP", float(ANGLES[1])) + array("vec3", "dsbrdf_MIXTURE", parts.reshape(-1, 3)) + text


_HEADER = """\
// A measured BRDF as a function: Directional Statistics BRDF model.
//
//   vec3 dsbrdf(vec3 omega_in, vec3 omega_out)
//
// returns the BRDF in 1/sr for red, green and blue (linear), without the cosine. Below the horizon it is 0.
//
"""

_HEADER_OF_SAMPLING = """\
//   vec3 dsbrdf_sample(vec3 omega_out, vec3 random)
//   float dsbrdf_pdf(vec3 omega_in, vec3 omega_out)
//
// draw a direction omega_in with three independent numbers from 0 to 1, and return its density in 1/sr: the weight of
// a sample is dsbrdf(omega_in, omega_out) * omega_in.z / dsbrdf_pdf(omega_in, omega_out). The density of a direction
// below the horizon, which some samples at grazing angles are, is 0: such a sample is black.
//
"""

_FRAME = """\
// Directions point away from the surface; they are unit vectors in the frame whose z axis is the normal.
//
"""

_HEADER_OF_COMPONENT = """\
// This is a component, the LABEL: its share of the values of the whole material.
//
//   vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown)
//
// returns all components, times their weights: shown.x of the specular spike, shown.y of the specular lobe, shown.z of
// the diffuse part. A component that the material does not have is 0. With vec3(1.0) it is the whole material.
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

_WHOLE = """\
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  return dsbrdf_model(dsbrdf_angles(omega_in, omega_out));
}
"""

_SHARES = """\
vec3 dsbrdf_shown(vec3 omega_in, vec3 omega_out, vec3 shown) {
  if (omega_in.z < 0.0 || omega_out.z < 0.0) return vec3(0.0);
  dsbrdf_Angles angles = dsbrdf_angles(omega_in, omega_out);
  vec3 whole = dsbrdf_model(angles);
  // Logarithms of the readable lobes; that of a lobe that is not there is never the largest.
  vec3 guide[3] = vec3[3](vec3(-1e30), vec3(-1e30), vec3(-1e30));
  float rows[COUNT];
  dsbrdf_guide_rows(angles.theta_diff, rows);
  for (int lobe = 0; lobe < LOBES; ++lobe) {
    float kappa = exp(rows[3 * LOBES + lobe]), gamma = exp(rows[4 * LOBES + lobe]);
    vec3 height = vec3(rows[lobe], rows[LOBES + lobe], rows[2 * LOBES + lobe]);
    guide[PLACES[lobe]] = height - kappa * dsbrdf_log1p(gamma * dsbrdf_stretched(angles, rows[5 * LOBES + lobe]));
  }
  vec3 top = max(guide[0], max(guide[1], guide[2]));
  vec3 spike = exp(guide[0] - top), wide = exp(guide[1] - top), diffuse = exp(guide[2] - top);
  vec3 specular = spike + wide, total = specular + diffuse;

  float q = angles.squared / dsbrdf_HALO, halo = 1.0 / (1.0 + q * q);
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
vec3 dsbrdf(vec3 omega_in, vec3 omega_out) {
  return dsbrdf_shown(omega_in, omega_out, vec3(WEIGHTS));
}
"""

_SAMPLING = """
// The first part of the mixture for a direction.
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
  turn /= length(turn);  // cosine and sine may be as coarse as 1e-3
  for (int i = 0; i < PARTS; ++i) {
    vec3 part = dsbrdf_MIXTURE[first + i];
    if (random.x < part.z) {  // omega_out mirrored at a normal that it sees
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
