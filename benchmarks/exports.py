"""What other programs make of a material: the error of each export's round trip, lit spheres, and sampling.

Mitsuba 3 opens a fit as the BSDF ``dsbrdf`` and as ``.bsdf`` (RGB and spectral), and the measurement itself as
``.bsdf``. The columns:

- values: median and, for the BSDF, largest relative difference from what was exported, at 10,000 pairs of directions,
  half of them near the mirror direction; values below 1e-3 /sr count as 1e-3. "far" is the share of the pairs at which
  the ``.bsdf`` file of the fit is more than 10 % off.
- spheres: PSNR under three lights against the sphere of the measurement, of this library's own picture of the fit, of
  Mitsuba's pictures, and of the nearest OpenPBR surface, rendered by this library, whose values of it are those of
  MaterialX's shaders. Pixels are means over points, and those on the edge are left out.
- sampling: variance of the weights times the time of a sample, of the cosine's sampling divided by the model's: how
  many times the work the cosine needs for the same error; and samples per second. Means over theta_out 0, 30, 60, 75
  degrees, of this library (NumPy) and of the BSDF in Mitsuba (LLVM).
"""

import argparse
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf import DSBRDF, ConvergenceWarning, Measurement, decompose, fit, render_sphere, save
from dsbrdf.arrays import Array
from dsbrdf.data import half_difference
from dsbrdf.extras import require
from dsbrdf.output.export.materialx import fit_openpbr
from dsbrdf.output.export.mitsuba import register
from dsbrdf.output.export.rgl import SPECTRA, WAVELENGTHS, rgl_bsdf
from dsbrdf.rendering import THREE_LIGHTS, displayed, exposure, psnr, sphere_normals
from dsbrdf.rendering.sphere import Source

SIZE = 96  # pixels
SAMPLES_PER_PIXEL_SIDE = 4
ANGLES = np.radians([0.0, 30.0, 60.0, 75.0])
N_SAMPLES = 100_000
N_REPEATS = 3
MIN_REFERENCE_VALUE = 1e-3  # 1/sr; relative errors of smaller values would say nothing.
MAX_CLOSE_ERROR = 0.1
SPECTRAL_SAMPLES = [430.0, 490.0, 550.0, 620.0]
"""Wavelengths at which spectral files are compared [nm]."""
HEADS = {
    "values": ("BSDF median", "largest", ".bsdf of fit", "far", "spectral", ".bsdf of data"),
    "spheres": ("library", "BSDF", ".bsdf of fit", ".bsdf of data", "OpenPBR"),
    "sampling": ("NumPy gain", "samples/s", "Mitsuba gain", "samples/s"),
}
WIDTH = 14


class Files:
    """A fit and its measurement in Mitsuba's formats, in a folder."""

    def __init__(self, measurement: Measurement, model: DSBRDF, folder: Path) -> None:
        self.model = folder / "model.json"
        save(model, self.model)
        contents = {
            "fit.bsdf": rgl_bsdf(model),
            "spectral.bsdf": rgl_bsdf(model, spectral=True),
            "data.bsdf": rgl_bsdf(measurement),
        }
        for name, content in contents.items():
            (folder / name).write_bytes(content)
        self.fit, self.spectral, self.data = (folder / name for name in contents)


def loaded(mitsuba: Any, path: Path) -> Any:
    """BSDF of a file, of the kind that the file's name tells."""
    kind = "measured" if path.suffix == ".bsdf" else "dsbrdf"
    return mitsuba.load_dict({"type": kind, "filename": str(path)})


def surface(mitsuba: Any, wi: Array) -> Any:
    """Surface seen from directions (n, 3)."""
    found = import_module("drjit").zeros(mitsuba.SurfaceInteraction3f, len(wi))
    found.wi = mitsuba.Vector3f(wi.T.astype(np.float32))
    return found


def pairs() -> tuple[Array, Array]:
    """Pairs of directions up to 80 degrees from the normal."""
    random = np.random.default_rng(0)
    cosine, turn = random.uniform(np.cos(np.radians(80.0)), 1.0, (2, 10_000)), random.uniform(0.0, 6.3, (2, 10_000))
    sine = np.sqrt(1.0 - cosine**2)
    first, second = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1)
    near = first * [-1.0, -1.0, 1.0] + random.normal(0.0, 0.05, first.shape)
    near[:, 2] = np.maximum(near[:, 2], 0.1)
    second[::2] = (near / np.linalg.norm(near, axis=1)[:, None])[::2]
    return first, second


def errors(mitsuba: Any, path: Path, expected: Array, wi: Array, wo: Array) -> Array:
    """Relative differences of a file's values (n, 3), or (n, 4) in a spectral variant, from those expected."""
    seen = surface(mitsuba, wi)
    if mitsuba.is_spectral:
        seen.wavelengths = SPECTRAL_SAMPLES
    values = np.array(
        loaded(mitsuba, path).eval(mitsuba.BSDFContext(), seen, mitsuba.Vector3f(wo.T.astype(np.float32)))
    )
    return np.abs(values.T / wo[:, 2:] - expected) / np.maximum(expected, MIN_REFERENCE_VALUE)


def round_trips(measurement: Measurement, model: DSBRDF, files: Files) -> list[float]:
    """Figures of `HEADS` "values"."""
    wi, wo = pairs()
    angles = half_difference(wo, wi)
    of_fit, of_data = model.evaluate(*angles), measurement.interpolated.evaluate(*angles)
    mitsuba = variant("llvm_ad_spectral")
    basis = np.stack([np.interp(SPECTRAL_SAMPLES, WAVELENGTHS, row) for row in SPECTRA])
    spectral = errors(mitsuba, files.spectral, of_fit @ basis, wi, wo)
    mitsuba = variant("llvm_ad_rgb")
    exact = errors(mitsuba, files.model, of_fit, wi, wo)
    found = [errors(mitsuba, path, values, wi, wo) for path, values in ((files.fit, of_fit), (files.data, of_data))]
    far = float((found[0].max(axis=1) > MAX_CLOSE_ERROR).mean())
    tables = [float(np.median(error)) for error in (found[0], spectral, found[1])]
    return [float(np.median(exact)), float(exact.max()), tables[0], far, *tables[1:]]


def variant(name: str) -> Any:
    """Return Mitsuba with this variant set and the BSDF of dsbrdf registered."""
    mitsuba = import_module("mitsuba")
    mitsuba.set_variant(name)
    register()
    return mitsuba


def picture(mitsuba: Any, path: Path) -> Array:
    """Mitsuba's sphere of a file under three lights, linear RGB; a picture for each light has no noise."""
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "sensor": {
            "type": "orthographic",
            "to_world": mitsuba.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
            "sampler": {"type": "stratified", "sample_count": 4 * SAMPLES_PER_PIXEL_SIDE**2},
        },
        "sphere": {"type": "sphere", "bsdf": loaded(mitsuba, path)},
    }
    total = np.zeros((SIZE, SIZE, 3))
    for light in THREE_LIGHTS:
        emitter = {
            "type": "directional",
            "direction": [-part for part in light.direction],
            "irradiance": {"type": "rgb", "value": list(light.irradiance)},
        }
        total += np.array(mitsuba.render(mitsuba.load_dict(scene | {"light": emitter})), dtype=float)[..., :3]
    return total


def reference(source: Source) -> Array:
    """Sphere by this library, pixels being means over points."""
    finer = render_sphere(source, size=SIZE * SAMPLES_PER_PIXEL_SIDE)
    return finer.reshape(SIZE, SAMPLES_PER_PIXEL_SIDE, SIZE, SAMPLES_PER_PIXEL_SIDE, 3).mean(axis=(1, 3))


def spheres(measurement: Measurement, model: DSBRDF, files: Files) -> list[float]:
    """Figures of `HEADS` "spheres"."""
    inside = np.asarray(
        sphere_normals(SIZE * SAMPLES_PER_PIXEL_SIDE)[1]
        .reshape(SIZE, SAMPLES_PER_PIXEL_SIDE, SIZE, SAMPLES_PER_PIXEL_SIDE)
        .all(axis=(1, 3))
    )
    measured, mitsuba = reference(measurement), variant("llvm_ad_rgb")
    factor = exposure(measured, inside)
    pictures = [reference(model), *(picture(mitsuba, path) for path in (files.model, files.fit, files.data))]
    pictures.append(reference(fit_openpbr(model.evaluate, decompose(model).layers).surface.evaluate))
    return [psnr(displayed(measured, factor), displayed(one, factor), inside) for one in pictures]


def sampling(model: DSBRDF, files: Files) -> list[float]:
    """Figures of `HEADS` "sampling"."""
    random, mitsuba = np.random.default_rng(0), variant("llvm_ad_rgb")
    bsdf = loaded(mitsuba, files.model)
    context, uniform = mitsuba.BSDFContext(), random.random((3, N_SAMPLES)).astype(np.float32)
    one, two = mitsuba.Float(uniform[0]), mitsuba.Point2f(uniform[1:])
    radius, turn = np.sqrt(uniform[1]), 2.0 * np.pi * uniform[2]
    cosines = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - uniform[1])], axis=-1).astype(float)
    cosines /= np.linalg.norm(cosines, axis=1)[:, None]

    figures = []
    for theta in ANGLES.tolist():
        towards = np.broadcast_to([np.sin(theta), 0.0, np.cos(theta)], (N_SAMPLES, 3))
        seen = surface(mitsuba, towards)

        def by_cosine(seen: Any = seen) -> Array:
            wo = mitsuba.warp.square_to_cosine_hemisphere(two)
            return np.array(bsdf.eval(context, seen, wo) * (np.pi / wo.z)).T

        ways: list[Callable[[], Array]] = [
            lambda towards=towards: model.sample(towards, random).weight,  # type: ignore[misc]
            lambda towards=towards: np.pi * model.evaluate_directions(cosines, towards),  # type: ignore[misc]
            lambda seen=seen: np.array(bsdf.sample(context, seen, one, two)[1]).T,  # type: ignore[misc]
            by_cosine,
        ]
        work, speed = zip(*(work_and_speed(way) for way in ways), strict=True)
        figures.append([work[1] / work[0], speed[0], work[3] / work[2], speed[2]])
    return [float(np.mean(column)) for column in zip(*figures, strict=True)]


def work_and_speed(way: Callable[[], Array]) -> tuple[float, float]:
    """Variance of the weights' mean over the channels, times the time of a sample, and samples per second."""
    weights, seconds = way(), []
    for _ in range(N_REPEATS):
        start = time.perf_counter()
        way()
        seconds.append(time.perf_counter() - start)
    return float(weights.mean(axis=1).var()) * min(seconds), len(weights) / min(seconds)


def main(argv: Sequence[str]) -> int:
    """Print the figures of each material and their medians."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks exports", description=__doc__)
    add_arguments(parser, every=1, names="rgl_")
    arguments = parser.parse_args(argv)
    require("mitsuba", "mitsuba", purpose="this benchmark")
    rows: dict[str, list[list[float]]] = {part: [] for part in HEADS}
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter("ignore", ConvergenceWarning)
        for measurement in chosen_measurements(arguments):
            model = fit(measurement).model
            files = Files(measurement, model, Path(folder))
            found = (round_trips(measurement, model, files), spheres(measurement, model, files), sampling(model, files))
            for part, figures in zip(HEADS, found, strict=True):
                rows[part].append(figures)
                print_row(f"{measurement.name} {part}", figures)
    for part, heads in HEADS.items():
        print(f"{'':34}" + "".join(head.rjust(WIDTH) for head in heads))
        print_row(f"median of {len(rows[part])}, {part}", np.median(rows[part], axis=0).tolist())
    return 0


def print_row(name: str, figures: Sequence[float]) -> None:
    """Print one line."""
    print(f"{name:40}" + "".join(f"{figure:{WIDTH}.3g}" for figure in figures), flush=True)
