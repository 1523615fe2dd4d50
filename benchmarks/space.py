"""The space of materials: whether neighbours are of one kind, and whether a blend lies between its ends.

``python -m benchmarks space --fits FITS`` takes a folder that ``dsbrdf fit FOLDER -o FITS`` has written. Kinds are by
the names of MERL's and RGL's materials. "one of three" is the fraction of materials that have one of their own kind
among the three nearest, "mean" the fraction of all these that are; by chance they are 36 and 14 %. A midpoint of two
materials lies between if it is nearer to each of them than they are to each other.
"""

import argparse
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from dsbrdf import DSBRDF, blend, space
from dsbrdf.output.serialize import read_model_file

KINDS = {
    "metal": "alum-bronze aluminium black-oxidized-steel brass chrome hematite nickel ss440 tungsten-carbide",
    "plastic": "alumina-oxide blue-acrylic delrin gray-plastic neoprene-rubber pink-plastic polyethylene pvc "
    "red-plastic red-specular-plastic white-acrylic white-diffuse-bball yellow-matte-plastic",
    "phenolic": "red-phenolic specular-blue-phenolic specular-green-phenolic specular-maroon-phenolic "
    "specular-orange-phenolic specular-white-phenolic specular-yellow-phenolic",
    "stone": "black-obsidian pink-jasper",
    "fabric": "acrylic_felt_pink black-fabric blue-fabric dark-specular-fabric green-fabric light-brown-fabric "
    "pink-fabric red-fabric white-fabric",
    "effect paint": "aurora_white blue-metallic-paint cc_nothern_aurora chm_mint color-changing-paint1 "
    "color-changing-paint2 color-changing-paint3 gold-metallic-paint3 gold-paint green-metallic-paint ilm_l3_37_matte "
    "pearl-paint satin_purple silver-metallic-paint2 silver-paint two-layer-gold two-layer-silver vch_golden_yellow",
    "paint": "cg_sunflower colodur_azure_4e green-latex orange-paint purple-paint white-paint yellow-paint",
    "wood": "cherry-235 fruitwood-241 ipswich-pine-221 natural-209 pickled-oak-260 special-walnut-224",
}
KIND_OF = {name: kind for kind, names in KINDS.items() for name in names.split()}
N_NEAREST = 3


def neighbours(models: dict[str, DSBRDF]) -> tuple[float, float]:
    """Print each material without one of its kind nearby; return both fractions."""
    materials, alike = space(models), []
    for name in models:
        near = [other for other, _ in materials.nearest(name, N_NEAREST)]
        alike.append([kind_of(other) == kind_of(name) for other in near])
        if not any(alike[-1]):
            print(f"{kind_of(name):14}{name:34}near {', '.join(near)}")
    return float(np.mean(np.any(alike, axis=1))), float(np.mean(alike))


def kind_of(name: str) -> str:
    """Kind of a material by its name, which may begin with that of its data base."""
    return KIND_OF.get(name) or KIND_OF[name.partition("_")[2]]


def midpoints(models: dict[str, DSBRDF], count: int) -> list[float]:
    """Return for random pairs the distance of the midpoint from its farther end, over that of the ends."""
    pairs = list(combinations(models, 2))
    chosen = np.random.default_rng(0).permutation(len(pairs))[:count]
    found = []
    for first, second in (pairs[index] for index in chosen.tolist()):
        ends = models[first], models[second]
        distance = space({"a": ends[0], "middle": blend(*ends, 0.5), "b": ends[1]}).distance
        found.append(float(max(distance[0, 1], distance[1, 2]) / distance[0, 2]))
        if found[-1] >= 1.0:
            print(f"the midpoint of {first} and {second} is not between them: {found[-1]:.3f}")
    return found


def main(argv: Sequence[str]) -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks space", description=__doc__)
    parser.add_argument("--fits", type=Path, required=True, help="a folder of models")
    parser.add_argument("--pairs", type=int, default=300, help="random pairs to blend (default: 300)")
    arguments = parser.parse_args(argv)
    models = {path.stem: read_model_file(path)[0] for path in sorted(arguments.fits.glob("*.json"))}
    if not models:
        raise SystemExit(f"{arguments.fits} holds no .json file")
    one, mean = neighbours(models)
    print(f"{len(models)} materials: one of three is of the same kind for {one:.1%}; mean {mean:.1%}")
    found = midpoints(models, arguments.pairs)
    between = float(np.mean(np.array(found) < 1.0))
    print(f"{between:.1%} of {len(found)} midpoints lie between their ends; largest {max(found):.3f}")
    return 0
