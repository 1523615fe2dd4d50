"""Sphinx extension: before pages are read, writes those that come from the code into the folder ``generated``."""

import json
from collections.abc import Iterator
from pathlib import Path

import reference
from pictures import MEASURED
from sphinx.application import Sphinx


def write_pages(app: Sphinx) -> None:
    """Write the references and the gallery."""
    folder = Path(app.srcdir) / "generated"
    document = reference.openapi_document()
    _write_if_changed(folder / "command_line.md", reference.command_line())
    _write_if_changed(folder / "http.md", reference.http(document))
    _write_if_changed(folder / "openapi.json", json.dumps(document, indent=1))
    _write_if_changed(folder / "measured.md", "\n".join(_measured()))


def _write_if_changed(file: Path, content: str) -> None:
    """Write a file, unless it has this content: Sphinx reads again what is newer than its pages."""
    if not file.is_file() or file.read_text() != content:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content)


def _measured() -> Iterator[str]:
    """Yield the lines of the measured materials whose strips of spheres are kept with the pages."""
    for name, numbers in json.loads((MEASURED / "materials.json").read_text()).items():
        panels = ", ".join(numbers["panels"])
        yield f"## {name.removeprefix('rgl_').replace('_', ' ')}\n"
        yield f"![lit spheres: {panels}](/_static/measured/{name}.webp){{.strip}}\n"
        yield (
            f"{panels}. {numbers['n_lobes']} lobes; relative_rms {numbers['relative_rms']:.3f}, "
            f"{numbers['excess']:.2f} times the floor; psnr {numbers['psnr']:.1f} dB.\n"
        )


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages when Sphinx starts, before it looks for what to read."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
