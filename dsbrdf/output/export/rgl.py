"""Write a model, a component or a measurement as an RGL ``.bsdf`` file for Mitsuba 3 (``measured``) and pbrt-v4.

For each angle theta_i of the first direction (at azimuth phi_i = 0, as the material is isotropic), the file has two
warps of the unit square. The first warp, ``luminance``, maps uniform random points to points that are dense where much
light is reflected. The second warp, ``vndf``, maps these points to half vectors (u, v) with

    theta_half = pi/2 u**2,    azimuth from the first direction = (2 v - 1) pi,

and ``rgb`` holds f cos(theta_out) 4 sigma / ndf on a grid of points between the two warps (Dupuy and Jakob 2018,
section 4). Here ``vndf`` is the reflected luminance plus two uniform densities of twice the mean luminance, so that no
direction is far from a node. The density of sampled directions is corrected by ``luminance``. Division by ``ndf``, the
mean value at each theta_half, makes ``rgb`` smooth; sigma is 1/4.

Mitsuba's RGB variants read ``rgb``. Mitsuba's spectral variants and pbrt read ``spectra`` at ``wavelengths`` [nm]
instead, which are the RGB values times `SPECTRA`. No program reads a file that has both ``rgb`` and ``spectra``.
"""

import numpy as np

from dsbrdf.arrays import Array, Evaluate
from dsbrdf.data.geometry import half_difference, spherical
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.rgl import RglMaterial, Warp, bilinear, encode_tensors
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.rendering.environment import LUMINANCE

# The angles theta_i [rad] are dense near the horizon, where the BRDF changes fastest.
_THETA_I = np.radians(89.5) * (1.0 - (1.0 - np.linspace(0.0, 1.0, 40)) ** 1.5)
_N_TABLE_NODES = 64  # number of nodes along each axis of the tables rgb and luminance
_VNDF_SHAPE = 48, 128  # numbers of nodes of the table vndf in azimuth and theta_half
_N_NDF_NODES = 512
_UNIFORM_DENSITY_WEIGHT = 2.0
"""Weight of each uniform density that is added to the reflected luminance, as a multiple of the mean luminance."""


def rgl_bsdf(
    source: ReflectanceModel | Measurement | RglMaterial, description: str = "", *, spectral: bool = False
) -> bytes:
    """Return the bytes of a ``.bsdf`` file, about 4 MB, 12 MB if spectral.

    A measurement is interpolated; the values of other sources need not be reciprocal. The description is stored in the
    file. A spectral file is for Mitsuba's spectral variants and pbrt-v4, and an RGB file for Mitsuba's RGB variants.
    """
    evaluate = source.interpolated.evaluate if isinstance(source, Measurement) else source.evaluate
    # The geometric mean of the luminance at each theta_half, as two rows that are equal for all azimuths.
    theta_half = 0.5 * np.pi * np.linspace(0.0, 1.0, _N_NDF_NODES) ** 2
    theta_diff = np.radians([5.0, 20.0, 40.0, 60.0])
    values = evaluate(*np.broadcast_arrays(theta_half[:, None], theta_diff, np.array(np.pi / 2))) @ LUMINANCE
    ndf = np.tile(np.exp(np.mean(np.log(values + 1e-4), axis=1)), (2, 1))
    slices = [_slice(evaluate, ndf, float(theta)) for theta in _THETA_I]
    vndf, luminance, rgb = (np.stack(parts)[None].astype(np.float32) for parts in zip(*slices, strict=True))
    fields = {
        "description": np.frombuffer((description or "written by dsbrdf").encode(), np.uint8),
        "phi_i": np.zeros(1, np.float32),
        "theta_i": _THETA_I.astype(np.float32),
        "sigma": np.full((2, 2), 0.25, np.float32),
        "ndf": ndf.astype(np.float32),
        "vndf": vndf,
        "luminance": luminance,
        "jacobian": np.ones(1, np.uint8),
    }
    if not spectral:
        return encode_tensors(fields | {"rgb": rgb})
    spectra = (rgb.swapaxes(2, 4) @ SPECTRA).swapaxes(2, 4).astype(np.float32)
    return encode_tensors(fields | {"wavelengths": WAVELENGTHS.astype(np.float32), "spectra": spectra})


def _slice(evaluate: Evaluate, ndf: Array, theta_i: float) -> tuple[Array, Array, Array]:
    """Return the tables vndf, luminance and rgb of the file for one angle theta_i [rad]."""
    v, u = (part.ravel() for part in np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in _VNDF_SHAPE), indexing="ij"))
    reflected, jacobian = _reflected(evaluate, theta_i, u, v)
    density = ((reflected @ LUMINANCE) * jacobian).reshape(_VNDF_SHAPE)
    mean = density.mean()
    # Half vectors that are uniform on the hemisphere have a density over (u, v) proportional to u sin(theta_half).
    even = (u * np.sin(0.5 * np.pi * u * u)).reshape(_VNDF_SHAPE)
    density = density + max(mean, 1e-12) * _UNIFORM_DENSITY_WEIGHT * (1.0 + even / even.mean())
    warp = Warp.of(density)
    side = np.linspace(0.0, 1.0, _N_TABLE_NODES)
    rows, columns = (part.ravel() for part in np.meshgrid(side, side, indexing="ij"))
    u, v = warp.sample(columns, rows)
    reflected, jacobian = _reflected(evaluate, theta_i, u, v)
    rgb = (reflected / bilinear(ndf, u, v)[:, None]).T.reshape(3, _N_TABLE_NODES, _N_TABLE_NODES)
    left = (reflected @ LUMINANCE) * jacobian / bilinear(warp.density, u, v)
    luminance = left.reshape(_N_TABLE_NODES, _N_TABLE_NODES)
    return density, luminance + 1e-3 * max(float(luminance.mean()), 1e-12), rgb


def _reflected(evaluate: Evaluate, theta_i: float, u: Array, v: Array) -> tuple[Array, Array]:
    """Return ``f cos(theta_out)`` (n, 3) at half vectors (u, v), and the solid angle of omega_out per du dv."""
    theta_half, azimuth = 0.5 * np.pi * u * u, (2.0 * v - 1.0) * np.pi
    sine = np.sin(theta_half)
    half, first = spherical(theta_half, azimuth), spherical(theta_i, 0.0)
    cosine = half @ first
    second = 2.0 * cosine[:, None] * half - first
    above = (cosine > 0.0) & (second[:, 2] > 0.0)
    values = np.zeros((u.size, 3))
    values[above] = evaluate(*half_difference(first, second[above])) * second[above, 2:]
    return values, np.maximum(2.0 * np.pi**2 * u * sine, 1e-6) * 4.0 * np.maximum(cosine, 0.0)


WAVELENGTHS = np.arange(400.0, 701.0, 20.0)
"""Wavelengths of the nodes of spectra [nm]; spectra are linear between the nodes and constant beyond them."""
_RED = [0.0574, 0.0537, 0.0299, 0.0047, 0, 0, 0, 0, 0, 0.1347, 0.7972, 1, 1, 1, 1, 1]
_GREEN = [0, 0, 0, 0, 0.2587, 0.7471, 1, 1, 1, 0.7935, 0.2002, 0, 0, 0, 0, 0]
SPECTRA = np.array([_RED, _GREEN, 1.0 - np.add(_RED, _GREEN)])
"""Spectra of red, green and blue in linear sRGB at the 16 wavelengths in `WAVELENGTHS`, shape (3, 16)."""
