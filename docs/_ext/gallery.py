"""Writes the gallery and the spheres of the home page as Markdown and pictures."""

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from pictures import MEASURED, REFERENCE_VARIABLE, Exhibit, encode, reference_exhibits, synthetic_exhibits

_SYNTHETIC_INTRO = """A microfacet lobe and a diffuse term with 2 % noise, which
`dsbrdf.data.synthetic.synthetic_measurement` makes. Build the pages with `DSBRDF_REFERENCE_DATA` set to a folder of
MERL files, and they show those here."""
_REFERENCE_INTRO = """Each row shows a material of the folder that `DSBRDF_REFERENCE_DATA` named when these pages were
built, {count} in all. The data of {measured} are measurements. Those of {stand_ins} are *decoded stand-ins*: smooth
tables from neural networks that were fitted to measurements. They lack the noise and the defects of measurements, and
their figures must not be quoted as results on measurements."""
_STAND_IN_PREFIX = "merl_"  # of the names of files; the data are not those that the name makes one expect


def write_pictures(folder: Path, kept: Path) -> None:
    """Write ``spheres.md`` for the home page and ``gallery.md``, with their pictures, into a folder."""
    synthetic = synthetic_exhibits("environment")
    reference = os.environ.get(REFERENCE_VARIABLE)
    exhibits, failures, intro = synthetic, [], _SYNTHETIC_INTRO
    if reference:
        exhibits, failures = reference_exhibits(Path(reference), kept)
        measured = sum(exhibit.kind == "measured" for exhibit in exhibits)
        intro = _REFERENCE_INTRO.format(
            count=len(exhibits), measured=measured, stand_ins=len(exhibits) - measured or "none"
        )
    paint = synthetic[0]
    shown = {title: panel for title, panel in paint.panels.items() if not title.startswith("difference")}
    write_if_changed(folder / "spheres.md", "\n".join(_row(folder, paint, shown)).encode())
    sections = [line for exhibit in exhibits for line in _section(folder, exhibit)]
    missing = [f"Not shown, because it cannot be fitted: {failure}" for failure in failures]
    write_if_changed(folder / "measured.md", "\n".join(_measured()).encode())
    write_if_changed(folder / "gallery.md", "\n\n".join([intro, "\n".join(sections), *missing, ""]).encode())


def write_if_changed(file: Path, content: bytes) -> None:
    """Write a file, unless it has this content: Sphinx reads again what is newer than its pages."""
    if not file.is_file() or file.read_bytes() != content:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)


def _section(folder: Path, exhibit: Exhibit) -> Iterable[str]:
    """Yield the lines of one material: name, numbers, pictures."""
    title = exhibit.name.removeprefix(_STAND_IN_PREFIX).removeprefix("rgl_").replace("_", " ")
    yield f"### {title}\n"
    yield f"{exhibit.kind[0].upper()}{exhibit.kind[1:]}; {_numbers({**exhibit.metrics, 'n_lobes': exhibit.n_lobes})}\n"
    yield from _row(folder, exhibit, exhibit.panels)


def _measured() -> Iterable[str]:
    """Yield the lines of the measured materials whose strips of spheres are kept with the pages."""
    for name, numbers in json.loads((MEASURED / "materials.json").read_text()).items():
        panels = ", ".join(numbers["panels"])
        yield f"### {name.removeprefix('rgl_').replace('_', ' ')}\n"
        yield f"![lit spheres: {panels}](/_static/measured/{name}.webp){{.strip}}\n"
        yield f"{panels}. {_numbers(numbers)}\n"


def _numbers(numbers: Mapping[str, float]) -> str:
    return (
        f"{numbers['n_lobes']} lobes; relative_rms {numbers['relative_rms']:.3f}, {numbers['excess']:.2f} times the "
        f"floor; psnr {numbers['psnr']:.1f} dB."
    )


def _row(folder: Path, exhibit: Exhibit, panels: Mapping[str, object]) -> Iterable[str]:
    """Write the pictures of some panels and yield the lines of a grid that shows them."""
    yield f"::::{{grid}} 2 3 {len(panels)} {len(panels)}\n:gutter: 2\n:class-container: spheres\n"
    for title in panels:
        file = folder / "pictures" / f"{exhibit.name}-{title.replace(' ', '-').replace('.', '')}.png"
        write_if_changed(file, encode(exhibit.panels[title]))
        yield f":::{{grid-item}}\n![lit sphere, {title}](/generated/pictures/{file.name})\n\n{title}\n:::"
    yield "::::\n"
