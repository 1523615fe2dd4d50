"""How true the components are to materials of others, whose specular and diffuse light is known (Mitsuba with LLVM).

Moved is the light on the wrong side of specular and diffuse as a share of all light, channels added: the mean of
0, 40 and 70 degrees to the normal. Where one layer of microfacets is all specular light, its roughness alpha and its
reflectance at normal incidence (F0) and at 70 degrees (F70) are compared. The fraction of true values that lie within
the stated 90 % ranges is printed for alpha, F0, F70 and the diffuse light at normal incidence.
"""

import argparse
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import dsbrdf
from benchmarks.foreign_catalogue import CATALOGUE, ashikhmin_shirley, materials_of_kinds, ward_duer
from benchmarks.judgement import RULES, Judgement, Truth, judged
from dsbrdf import ConvergenceWarning, Measurement
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF, directions, nodes_above_horizon
from tests.support.foreign_materials import (
    Color,
    Material,
    car_paint,
    lambert,
    metal,
    plastic_material,
    principled_material,
)

METALS = ("Ag", "Al", "Au", "Cr", "Cu", "Mo", "Ni_palik", "TiN", "V_palik", "W")


def drawn(number: int, seed: int) -> dict[str, Material]:
    """Return materials of six kinds in turn: plastics, metals, principled, car paints and two formulas."""
    random = np.random.default_rng(seed)
    kinds = list(KINDS.items())
    chosen = [(k, *kinds[k % len(kinds)]) for k in range(number)]
    return {f"{kind}_{k:02}": draw(random) for k, kind, draw in chosen}


def _color(random: np.random.Generator, low: float, high: float, saturation: float = 1.0) -> Color:
    """A colour of logarithmically uniform brightness; the saturation scales how much its channels differ."""
    level = np.exp(random.uniform(np.log(low), np.log(high)))
    red, green, blue = (level * np.exp(-saturation * random.uniform(0.0, 1.5, 3))).tolist()
    return red, green, blue


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _drawn_plastic(random: np.random.Generator) -> Material:
    kind, mixed = str(random.choice(["ggx", "beckmann"])), bool(random.integers(2))
    color = _color(random, 0.02, 0.9)
    return plastic_material(_log_uniform(random, 0.03, 0.5), color, random.uniform(1.35, 1.8), kind, mixed)


def _drawn_metal(random: np.random.Generator) -> Material:
    name, kind = str(random.choice(METALS)), str(random.choice(["ggx", "beckmann"]))
    return metal(_log_uniform(random, 0.03, 0.5), name, kind)


def _drawn_principled(random: np.random.Generator) -> Material:
    return principled_material(
        _color(random, 0.05, 0.9),
        random.uniform(0.2, 0.8),
        metallic=float(random.choice([0.0, 0.0, 0.3, 0.7, 1.0])),
        clearcoat=float(random.choice([0.0, 0.0, 1.0])),
        specular=random.uniform(0.2, 0.9),
    )


def _drawn_car_paint(random: np.random.Generator) -> Material:
    flakes, ground = _color(random, 0.05, 0.5, 0.5), _color(random, 0.01, 0.3)
    return car_paint(
        _log_uniform(random, 0.006, 0.04), random.uniform(0.12, 0.4), flakes, ground, random.uniform(1.4, 1.6)
    )


def _drawn_ashikhmin_shirley(random: np.random.Generator) -> Material:
    specular = _color(random, 0.03, 0.4, 0.3)
    return ashikhmin_shirley(_log_uniform(random, 10.0, 3000.0), specular, _color(random, 0.02, 0.8))


def _drawn_ward(random: np.random.Generator) -> Material:
    ground = (lambert(_color(random, 0.02, 0.7)),) if random.random() < 0.7 else ()
    return Material((ward_duer(_log_uniform(random, 0.03, 0.35), _color(random, 0.03, 0.5, 0.5)),), ground)


KINDS = {
    "plastic": _drawn_plastic,
    "metal": _drawn_metal,
    "principled": _drawn_principled,
    "car_paint": _drawn_car_paint,
    "ashikhmin_shirley": _drawn_ashikhmin_shirley,
    "ward": _drawn_ward,
}


def measured(material: Material, name: str, noise: float) -> Measurement:
    """Values on the grid of a MERL file, with independent relative Gaussian noise."""
    above = nodes_above_horizon()
    half, diff, phi = np.nonzero(above)
    pair = directions(THETA_HALF[half], THETA_DIFF[diff], PHI_DIFF[phi])
    found = material.specular_values(*pair) + material.diffuse_values(*pair)
    if noise:
        found *= np.maximum(1.0 + noise * np.random.default_rng(0).standard_normal(found.shape), 0.0)
    values = np.full((3, *above.shape), -1.0)
    values[:, above] = found.T
    return Measurement.from_values(values, above, name)


def save_truth(truth: Truth, path: Path) -> None:
    """Write an .npz file, so that a decomposition can be judged again without Mitsuba."""
    sides = {"specular": truth.specular, "diffuse": truth.diffuse}
    arrays = {f"{side}_{k}": values for side, parts in sides.items() for k, values in enumerate(parts)}
    layer = {"alpha": truth.alpha, "f0": truth.f0, "f70": truth.f70}
    np.savez(path, allow_pickle=False, **arrays, **{name: one for name, one in layer.items() if one is not None})


def load_truth(path: Path) -> Truth:
    """Read what `save_truth` wrote."""
    with np.load(path) as file:
        specular, diffuse = (tuple(file[f"{side}_{k}"] for k in range(len(RULES))) for side in ("specular", "diffuse"))
        alpha, f0, f70 = (file.get(name) for name in ("alpha", "f0", "f70"))
        return Truth(specular, diffuse, None if alpha is None else float(alpha), f0, f70)


def fitted(name: str, material: Material, noise: float, folder: Path | None) -> tuple[dsbrdf.DSBRDF, Truth]:
    """Fit a material; return the model and the truth, which are kept in the folder if there is one."""
    result, truth = dsbrdf.fit(dsbrdf.profiles(measured(material, name, noise))), Truth.of(material)
    if folder is not None:
        dsbrdf.save(result, folder / f"{name}.json")
        save_truth(truth, folder / f"{name}.npz")
    return result.model, truth


def print_row(name: str, found: Judgement) -> None:
    """Print one line of the table."""
    surface = found.surface
    alpha = None if surface is None else surface.alpha
    f0, f70 = (None, None) if surface is None else (surface.f0, surface.f70)
    layer = "" if alpha is None else f", alpha {alpha:+6.1%}"
    layer += "" if f0 is None else f", F0 {f0:5.1%}"
    layer += "" if f70 is None else f", F70 {f70:5.1%}"
    low, high = found.range
    stated = f"{low:.3f} to {high:.3f} {'holds' if found.inside else 'MISSES'} {found.true_share:.3f}"
    angles = " ".join(f"{moved:6.1%}" for moved in found.moved)
    print(f"{name:28} moved {angles}; diffuse {found.share:.3f}, {stated}{layer}; {found.structure}", flush=True)


def print_summary(rows: Sequence[Judgement]) -> None:
    """Print the spread of all figures."""
    moved = np.array([row.moved.mean() for row in rows])
    median, p90, largest = np.quantile(moved, [0.5, 0.9, 1.0])
    print(f"moved: mean {moved.mean():.2%}, median {median:.2%}, p90 {p90:.2%}, largest {largest:.2%} of {len(rows)}")
    surfaces = [row.surface for row in rows if row.surface is not None]
    pairs = {
        "alpha": [(one.alpha, one.alpha_inside) for one in surfaces],
        "F0": [(one.f0, one.f0_inside) for one in surfaces],
        "F70": [(one.f70, one.f70_inside) for one in surfaces],
    }
    for name, found in pairs.items():
        if sizes := [abs(error) for error, _ in found if error is not None]:
            holds = np.mean([inside for _, inside in found if inside is not None])
            median, p90, largest = np.quantile(sizes, [0.5, 0.9, 1.0])
            print(
                f"{name} of {len(sizes)} with one layer: median {median:.1%}, p90 {p90:.1%}, largest {largest:.1%}, "
                f"inside its range: {holds:.0%}"
            )
    widths = [row.range[1] - row.range[0] for row in rows]
    print(f"true share inside its range: {np.mean([row.inside for row in rows]):.0%}, widths: {np.median(widths):.3f}")
    warned = np.mean([row.is_warned or row.inside for row in rows])
    print(f"open split said: {sum(row.is_warned for row in rows)} of {len(rows)}; said or inside: {warned:.0%}")


def chosen_materials(arguments: argparse.Namespace) -> Mapping[str, Material]:
    """Return the catalogue, materials drawn at random, or those of difficult kinds."""
    if arguments.random:
        return drawn(arguments.random, arguments.seed)
    return materials_of_kinds() if arguments.kinds else CATALOGUE


def main(argv: Sequence[str]) -> int:
    """Print a line for each material, and the spread."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks truth", description=__doc__)
    parser.add_argument("--names", default="", help="only materials whose name contains one of these, with commas")
    parser.add_argument("--random", type=int, metavar="N", help="N materials drawn at random instead of the catalogue")
    parser.add_argument("--kinds", action="store_true", help="35 materials that scatter light several ways instead")
    parser.add_argument("--seed", type=int, default=1, help="of the random materials (default: 1)")
    parser.add_argument("--noise", type=float, default=0.0, help="relative noise of every value (default: 0)")
    models_help = "keep fits and truth there, and take those that are there; these are decomposed anew, with the time"
    parser.add_argument("--models", type=Path, metavar="DIR", help=models_help)
    arguments = parser.parse_args(argv)
    materials = chosen_materials(arguments)
    words = arguments.names.split(",")
    chosen = {name: material for name, material in materials.items() if any(word in name for word in words)}
    if not chosen:
        raise SystemExit(f"no material has one of {arguments.names} in its name")
    kind = f"random_{arguments.seed}" if arguments.random else "kinds" if arguments.kinds else "catalogue"
    folder = arguments.models and arguments.models / f"{kind}_noise_{arguments.noise:g}"
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    rows, seconds = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for name, material in chosen.items():
            if folder is not None and (folder / f"{name}.npz").exists():
                model, truth = dsbrdf.load(folder / f"{name}.json"), load_truth(folder / f"{name}.npz")
                start = time.perf_counter()
                parts = dsbrdf.decompose(model)
                seconds.append(time.perf_counter() - start)
            else:
                model, truth = fitted(name, material, arguments.noise, folder)
                parts = dsbrdf.decompose(model)  # as the fit left it
            rows.append(judged(parts, truth))
            print_row(name, rows[-1])
    print_summary(rows)
    if seconds:
        print(f"decompose: median {np.median(seconds):.2f} s, largest {max(seconds):.2f} s")
    return 0
