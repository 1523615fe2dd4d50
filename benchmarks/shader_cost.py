"""What a material's GLSL costs beside a plain GGX shader, in the browser, and what the smaller one loses.

Columns: the time of an evaluation over that of GGX (Smith's masking, Schlick's Fresnel, a Lambertian ground), of the
model, of the layers of its components, and of the model with its components; their PSNR on a sphere
under three lights against the measurement. The browser's renderer is SwiftShader, which computes on the processor: a
graphics card will show other ratios.
"""

import argparse
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.exports import pairs
from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf import ConvergenceWarning, decompose, fit, render_sphere
from dsbrdf.output.export.glsl import glsl_function
from dsbrdf.rendering import displayed, exposure, psnr, sphere_normals
from tests.support.webgl import ShaderCall, page_answers

SIZE = 128
N_TILES = 16
N_REPEATS = 11
GGX = """
vec3 ggx(vec3 i, vec3 o) {
  if (i.z < 0.0 || o.z < 0.0) return vec3(0.0);
  vec3 h = normalize(i + o);
  float a2 = 0.04, c = h.z * h.z * (a2 - 1.0) + 1.0, d = a2 / (3.14159265 * c * c);
  float v = 0.5 / (i.z * sqrt(a2 + (1.0 - a2) * o.z * o.z) + o.z * sqrt(a2 + (1.0 - a2) * i.z * i.z));
  float f = 0.04 + 0.96 * pow(1.0 - dot(h, i), 5.0);
  return vec3(d * v * f) + vec3(0.2, 0.1, 0.05) * (1.0 - f);
}

vec3 dsbrdf(vec3 i, vec3 o) {  // one evaluation alone takes too little time to be measured
  vec3 sum = vec3(0.0);
  for (int count = 0; count < CALLS_PER_PIXEL; ++count) {
    sum += ggx(i, o);
    o = vec3(0.8 * o.x - 0.6 * o.y, 0.6 * o.x + 0.8 * o.y, o.z);
  }
  return sum;
}
"""
CALLS_PER_PIXEL = 32
NOTHING = "vec3 dsbrdf(vec3 i, vec3 o) { return i + o; }"


def main(argv: Sequence[str]) -> int:
    """Print one line for each material, and the medians."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks shader_cost", description=__doc__)
    add_arguments(parser, every=1, names="rgl_")
    arguments = parser.parse_args(argv)
    first, second = (np.tile(part, (N_TILES, 1)) for part in pairs())
    inside = sphere_normals(SIZE)[1]
    print(f"{'':28}{'model':>9}{'layers':>9}{'parts':>9}{'lobes':>7}{'numbers':>9}{'PSNR':>7}{'of layers':>10}")
    rows = []
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        for measurement in chosen_measurements(arguments):
            model = fit(measurement).model
            components = decompose(model)
            sources = {
                "nothing": NOTHING,
                "GGX": GGX.replace("CALLS_PER_PIXEL", str(CALLS_PER_PIXEL)),
                "model": glsl_function(model),
            }
            sources |= {"layers": glsl_function(components.layers), "parts": glsl_function(next(iter(components)))}
            calls = {n: ShaderCall(s, "dsbrdf(a, b)", first, second) for n, s in sources.items()}
            with tempfile.TemporaryDirectory() as folder:
                times = dict(zip(calls, map(float, page_answers(calls, Path(folder), N_REPEATS)), strict=True))
            one = (times["GGX"] - times["nothing"]) / CALLS_PER_PIXEL
            ratios = [(times[n] - times["nothing"]) / one for n in [*sources][2:]]
            measured = render_sphere(measurement, size=SIZE)
            factor = exposure(measured, inside)
            shown = displayed(measured, factor)
            found = [
                psnr(shown, displayed(render_sphere(m, size=SIZE), factor), inside) for m in (model, components.layers)
            ]
            rows.append([*ratios, model.n_lobes, components.layers.n_numbers, *found])
            print_row(measurement.name, rows[-1])
    print_row(f"median of {len(rows)}", np.median(rows, axis=0).tolist())
    return 0


def print_row(name: str, figures: Sequence[float]) -> None:
    """Print one line."""
    widths = zip(figures, (9, 9, 9, 7, 9, 7, 10), (1, 1, 1, 0, 0, 1, 1), strict=True)
    print(f"{name:28}" + "".join(f"{figure:{width}.{digits}f}" for figure, width, digits in widths), flush=True)
