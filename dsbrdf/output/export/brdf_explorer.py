"""A model or a component as a ``.brdf`` file for Disney's BRDF Explorer: the GLSL function, and how it is called."""

from dsbrdf.fitting.decomposition import Component
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export.glsl import glsl_function


def brdf_explorer_file(source: DSBRDF | Component) -> str:
    """Return an analytic ``.brdf`` file, whose only parameter is a scale.

    Parameters
    ----------
    source : DSBRDF or Component

    Returns
    -------
    str
        ``BRDF(L, V, N, X, Y)`` gives the values in 1/sr, times ``scale``.

    Raises
    ------
    InvalidArgumentError
        If a parameter is too large for single precision.
    """
    return f"analytic\n\n::begin parameters\nfloat scale 0 4 1\n::end parameters\n\n{_shader(source)}"


def _shader(source: DSBRDF | Component) -> str:
    return f"""::begin shader
{glsl_function(source)}
vec3 BRDF(vec3 L, vec3 V, vec3 N, vec3 X, vec3 Y) {{
  mat3 frame = mat3(X, Y, N);
  return scale * dsbrdf(L * frame, V * frame);
}}
::end shader
"""
