"""A model as a GLSL function, for a fragment shader: OpenGL ES 3.0 (WebGL 2), OpenGL 3.3 and later.

In the templates, ``dsbrdf`` stands for the name of the function.

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

import re

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.decomposition import HALO, LABELS, Component
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.sampling import direction_sampler
from dsbrdf.output.export.glsl_model import MATH, constant, model_function, parameter_rows
from dsbrdf.output.export.glsl_sampling import sampling_functions
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
        Takes the place of ``dsbrdf``.  Every name in the source begins with it, so that a program can hold several.
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
        parts.append(sampling_functions(sampler))
    return f"// Written by dsbrdf {__version__}.\n" + "".join(parts).replace("dsbrdf", name)


def _shares(component: Component) -> str:
    """Return ``dsbrdf_shown``; the readable lobes are Student's t over slopes, and their rows logarithms."""
    labels = component.whole.labels
    rows, count = parameter_rows(component.whole.guide, "dsbrdf_guide")
    places = f"int[{len(labels)}]({', '.join(str(LABELS.index(label)) for label in labels)})"
    text = _SHARES.replace("COUNT", str(count)).replace("PLACES", places).replace("LOBES", str(len(labels)))
    return constant("HALO", HALO) + rows + text


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
