"""Render lit spheres, read environments, compare images, and map the space of materials."""

from dsbrdf.rendering.environment import THREE_LIGHTS, EnvironmentMap, read_environment
from dsbrdf.rendering.image_metrics import displayed, exposure, psnr, ssim
from dsbrdf.rendering.space import MaterialSpace, space
from dsbrdf.rendering.sphere import LIGHTINGS, render_sphere, sphere_likeness, sphere_normals

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
