"""Render lit spheres, read environments, compare images, and map the space of materials."""

from dsbrdf.rendering.environment import EnvironmentMap as EnvironmentMap
from dsbrdf.rendering.environment import read_environment as read_environment
from dsbrdf.rendering.space import MaterialSpace as MaterialSpace
from dsbrdf.rendering.space import space as space
from dsbrdf.rendering.sphere import LIGHTINGS as LIGHTINGS
from dsbrdf.rendering.sphere import THREE_LIGHTS as THREE_LIGHTS
from dsbrdf.rendering.sphere import displayed as displayed
from dsbrdf.rendering.sphere import exposure as exposure
from dsbrdf.rendering.sphere import psnr as psnr
from dsbrdf.rendering.sphere import render_sphere as render_sphere
from dsbrdf.rendering.sphere import sphere_likeness as sphere_likeness
from dsbrdf.rendering.sphere import sphere_normals as sphere_normals
from dsbrdf.rendering.sphere import ssim as ssim
