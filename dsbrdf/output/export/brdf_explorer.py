"""A model as a ``.brdf`` file for Disney's BRDF Explorer: the GLSL function, and how that program calls it."""

from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export.glsl import glsl_function

__all__ = ["brdf_explorer_file"]


def brdf_explorer_file(model: DSBRDF) -> str:
    """Return an analytic ``.brdf`` file, whose only parameter is a scale.

    Parameters
    ----------
    model : DSBRDF

    Returns
    -------
    str
        ``BRDF(L, V, N, X, Y)`` gives the values in 1/sr, times ``scale``.

    Raises
    ------
    InvalidArgumentError
        If a parameter is too large for single precision.
    """
    return f"analytic\n\n::begin parameters\nfloat scale 0 4 1\n::end parameters\n\n{_shader(model)}"


def _shader(model: DSBRDF) -> str:
    return f"""::begin shader
{glsl_function(model)}
vec3 BRDF(vec3 L, vec3 V, vec3 N, vec3 X, vec3 Y) {{
  mat3 frame = mat3(X, Y, N);
  return scale * dsbrdf(L * frame, V * frame);
}}
::end shader
"""
