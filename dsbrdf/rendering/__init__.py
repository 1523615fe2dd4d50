"""Render lit spheres, read environments, compare images, and map the space of materials."""

from dsbrdf.rendering.environment import EnvironmentMap, read_environment
from dsbrdf.rendering.space import MaterialSpace, space
from dsbrdf.rendering.sphere import (
    LIGHTINGS,
    THREE_LIGHTS,
    displayed,
    exposure,
    psnr,
    render_sphere,
    sphere_likeness,
    sphere_normals,
    ssim,
)

__all__ = [
    "LIGHTINGS",
    "THREE_LIGHTS",
    "EnvironmentMap",
    "MaterialSpace",
    "displayed",
    "exposure",
    "psnr",
    "read_environment",
    "render_sphere",
    "space",
    "sphere_likeness",
    "sphere_normals",
    "ssim",
]
