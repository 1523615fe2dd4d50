"""Lit spheres of measured materials and their fits, for the README and the gallery.

``python docs/_ext/pictures.py``, with ``DSBRDF_REFERENCE_DATA`` set to a folder of MERL files, writes them: those who
build the pages do not have the data.
"""

import json
import os
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np

import dsbrdf
from dsbrdf.output.sphere_panels import compare_spheres, cut_out
from dsbrdf.rendering import displayed

README_PICTURE = Path(__file__).parents[1] / "_static" / "spheres.webp"
README_MATERIALS = ("rgl_aurora_white", "rgl_satin_purple", "rgl_acrylic_felt_pink")
_README_COLUMNS = ("measured", "fit", "specular", "diffuse")
_README_SPHERE_SIZE = 384  # pixels
_README_GAP = 16  # pixels
_README_LINE_HEIGHT = 44  # pixels
MEASURED = Path(__file__).parents[1] / "_static" / "measured"
_DRAWN_SPHERE_SIZE = 224  # pixels
_STRIP_SPHERE_SIZE = 128  # pixels
_METRICS = ("relative_rms", "excess", "psnr")


def readme_picture(folder: Path, materials: Sequence[str] = README_MATERIALS) -> bytes:
    """Return a WebP file of materials in a folder, one in a row: measured, the fit, and the components of the fit."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    size, rows = _README_SPHERE_SIZE, len(materials)
    step = size + _README_GAP
    width, height = _README_LINE_HEIGHT + step * len(_README_COLUMNS), _README_LINE_HEIGHT + step * rows
    canvas = FigureCanvasAgg(Figure(figsize=(width / 100.0, height / 100.0), dpi=100.0, facecolor="none"))
    text = {"color": "0.5", "fontsize": 22, "ha": "center", "va": "center"}  # seen on white and on black
    for row, name in enumerate(materials):
        measurement = dsbrdf.read_merl(folder / f"{name}.binary")
        model = dsbrdf.fit(measurement).model
        compared = compare_spheres(measurement, model, with_components=False, lighting="environment", size=size)
        parts = [
            (part.label, dsbrdf.render_sphere(part, lighting="environment", size=size))
            for part in dsbrdf.decompose(model)
        ]
        highlights = np.sum([sphere for label, sphere in parts if label != "diffuse"], axis=0)
        panels = compared.panels | {
            "specular": displayed(highlights, compared.exposure),
            "diffuse": displayed(dict(parts)["diffuse"], compared.exposure),
        }
        below = step * (rows - 1 - row)
        title = name.removeprefix("rgl_").replace("_", " ")
        canvas.figure.text(22 / width, (below + step / 2) / height, title, rotation=90, **text)
        for column, panel in enumerate(_README_COLUMNS):
            canvas.figure.figimage(cut_out(panels[panel]), _README_LINE_HEIGHT + step * column, below)
    for column, panel in enumerate(_README_COLUMNS):
        place = _README_LINE_HEIGHT + step * (column + 0.5)
        canvas.figure.text(place / width, 1.0 - _README_LINE_HEIGHT / 2 / height, panel, **text)
    canvas.draw()
    file = BytesIO()
    Image.fromarray(np.asarray(canvas.buffer_rgba())).save(file, "webp", quality=90)
    return file.getvalue()


def write_measured(folder: Path) -> None:
    """Write a strip of spheres of each RGL material of a folder, and `materials.json` with their numbers.

    The other materials have other licences.
    """
    from PIL import Image

    table = {}
    for path in sorted(folder.glob("rgl_*.binary")):
        measurement = dsbrdf.read_merl(path)
        result = dsbrdf.fit(measurement)
        panels = compare_spheres(measurement, result.model, size=_DRAWN_SPHERE_SIZE).seen
        spheres = np.concatenate([cut_out(panel) for panel in panels.values()], axis=1)
        strip = Image.fromarray(np.rint(255.0 * spheres).astype(np.uint8))
        strip = strip.resize((_STRIP_SPHERE_SIZE * len(panels), _STRIP_SPHERE_SIZE), Image.Resampling.LANCZOS)
        strip.save(MEASURED / f"{path.stem}.webp", quality=85)
        metrics = {name: round(result.report.metrics[name] or 0.0, 4) for name in _METRICS}
        table[path.stem] = {"panels": [*panels], "n_lobes": result.model.n_lobes, **metrics}
    (MEASURED / "materials.json").write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    reference = Path(os.environ["DSBRDF_REFERENCE_DATA"])
    README_PICTURE.write_bytes(readme_picture(reference))
    write_measured(reference)
