"""Tables of known truth whose unit is right, and tables whose unit is wrong: what is said of their units.

Forty tables are dark, glossy, retro-reflecting, under-sampled or filled with zeros where nothing was measured; nothing
may be said of their units. Twenty are in per cent, in factors of pi, in integers, or multiplied by a cosine; the
sentence must name the factor or the cosine. Materials are sums of a diffuse term and microfacets, with 2 % noise.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from dsbrdf import ScatteredSamples
from dsbrdf.arrays import Array
from dsbrdf.data.geometry import spherical
from dsbrdf.samples.doubts import sample_doubts
from dsbrdf.samples.values import unmeasured_zeros

Truth = Callable[[Array, Array], Array]
_UNIT_WORDS = ("scale", "cosine", "multiply")
_NOISE = 0.02


def main(argv: Sequence[str]) -> int:
    """Print each table of which something wrong is said, then how many there are."""
    argparse.ArgumentParser(prog="python -m benchmarks table_units", description=__doc__).parse_args(argv)
    wrong = [(name, said) for name, samples in right_tables() if (said := _said(samples))]
    missed = [(name, said) for name, samples, word in wrong_tables() if word not in (said := _said(samples))]
    for kind, found in (("false", wrong), ("missed", missed)):
        for name, said in found:
            print(f"{kind}: {name}: {said}")
    n_right, n_wrong = sum(1 for _ in right_tables()), sum(1 for _ in wrong_tables())
    print(f"false sentences about units: {len(wrong)} of {n_right} tables; missed: {len(missed)} of {n_wrong}")
    return 0


def _said(samples: ScatteredSamples) -> str:
    return " ".join(text for text in sample_doubts(samples).sentences if any(word in text for word in _UNIT_WORDS))


def material(diffuse: float, f0: float, alpha: float, retro: float = 0.0) -> Truth:
    """Return a diffuse term, a GGX layer and a lobe back towards the light."""

    def values(omega_in: Array, omega_out: Array) -> Array:
        half = omega_in + omega_out
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        cosine, facing = half[:, 2], np.sum(half * omega_in, axis=1)
        slope = (1.0 - cosine**2) / np.maximum(cosine**2, 1e-12)
        density = alpha**2 / (np.pi * cosine**4 * (alpha**2 + slope) ** 2)
        roots = [np.sqrt(alpha**2 + (1.0 - alpha**2) * omega[:, 2] ** 2) for omega in (omega_in, omega_out)]
        shadow = 0.5 / (omega_out[:, 2] * roots[0] + omega_in[:, 2] * roots[1])
        back = retro * np.exp(-((np.arccos(np.clip(np.sum(omega_in * omega_out, axis=1), -1, 1)) / 0.12) ** 2))
        fresnel = f0 + (1.0 - f0) * (1.0 - np.clip(facing, 0.0, 1.0)) ** 5
        return np.asarray(diffuse / np.pi + fresnel * density * shadow + back)

    return values


MATERIALS = {
    "matte black": material(0.02, 0.04, 0.5),
    "black velvet": material(0.004, 0.01, 0.8),
    "lacquer": material(0.03, 0.04, 0.03),
    "glossy white": material(0.7, 0.04, 0.08),
    "satin grey": material(0.2, 0.05, 0.25),
    "rough metal": material(0.0, 0.6, 0.35),
    "polished metal": material(0.0, 0.9, 0.04),
    "retro-reflector": material(0.05, 0.04, 0.3, retro=8.0),
}


def goniometer(incidence: Sequence[float], step: float, aside: Sequence[float] = (0.0,)) -> tuple[Array, Array]:
    """Return directions of the light and the viewer, which moves in planes at some angles to that of the light."""
    theta_in, theta_out, turn = (
        axis.ravel() for axis in np.meshgrid(incidence, np.arange(-80.0, 80.1, step), aside, indexing="ij")
    )
    return spherical(np.radians(theta_in), np.full(theta_in.size, np.pi)), spherical(
        np.radians(theta_out), np.radians(turn)
    )


GEOMETRIES = {
    "one plane": goniometer((0.0, 15.0, 30.0, 45.0, 60.0, 70.0), 4.0),
    "planes": goniometer((10.0, 30.0, 50.0, 70.0), 8.0, (0.0, 30.0, 60.0, 90.0, 120.0, 150.0)),
    "coarse": goniometer((5.0, 25.0, 45.0, 65.0), 10.0, (0.0, 45.0, 90.0, 135.0)),
    "one incidence": goniometer((45.0,), 2.5, (0.0, 90.0)),
}


def measured(truth: Truth, directions: tuple[Array, Array], seed: int = 1) -> ScatteredSamples:
    """Return samples with noise, grey."""
    values = truth(*directions)
    values = values * (1.0 + _NOISE * np.random.default_rng(seed).standard_normal(values.size))
    return ScatteredSamples.from_arrays(*directions, np.repeat(np.maximum(values, 0.0)[:, None], 3, axis=1))


def right_tables() -> Iterator[tuple[str, ScatteredSamples]]:
    """Yield tables in 1/sr: every material in every geometry, and some with zeros where nothing was measured."""
    for name, truth in MATERIALS.items():
        for geometry, directions in GEOMETRIES.items():
            yield f"{name}, {geometry}", measured(truth, directions)
        samples = measured(truth, GEOMETRIES["planes"])
        seen = np.maximum(*(np.arccos(omega[:, 2]) for omega in (samples.omega_in, samples.omega_out))) < 1.15
        values = np.where(seen[:, None], samples.values.round(6), 0.0)
        empty, _ = unmeasured_zeros(samples.omega_in, samples.omega_out, values)
        kept = ~empty
        yield (
            f"{name}, zeros",
            ScatteredSamples.from_arrays(samples.omega_in[kept], samples.omega_out[kept], values[kept]),
        )


def wrong_tables() -> Iterator[tuple[str, ScatteredSamples, str]]:
    """Yield tables in another unit, with a word that the sentence about them must have."""
    for name in ("glossy white", "satin grey", "rough metal", "polished metal"):
        for geometry in ("one plane", "planes"):
            samples = measured(MATERIALS[name], GEOMETRIES[geometry])
            yield f"{name}, {geometry}, per cent of pi f", _scaled(samples, 100.0 * np.pi), "0.003183"
            if name == "glossy white":
                yield f"{name}, {geometry}, pi f", _scaled(samples, np.pi), "0.3183"
                yield f"{name}, {geometry}, integers", _scaled(samples, 1500.0, whole=True), "0.0006667"
                yield f"{name}, {geometry}, per cent", _scaled(samples, 100.0), "0.01"
    for name in ("glossy white", "satin grey", "rough metal"):
        for side in ("in", "out"):
            samples = measured(MATERIALS[name], GEOMETRIES["planes"])
            cosine = (samples.omega_in if side == "in" else samples.omega_out)[:, 2:]
            yield f"{name}, times the cosine of theta_{side}", _scaled(samples, cosine), f'set cosine to "{side}"'


def _scaled(samples: ScatteredSamples, factor: float | Array, *, whole: bool = False) -> ScatteredSamples:
    values = samples.values * factor
    return ScatteredSamples.from_arrays(samples.omega_in, samples.omega_out, values.round() if whole else values)
