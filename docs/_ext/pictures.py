"""Lit spheres for the pages: of synthetic measurements, or of the measurements in a folder, and of their fits.

``python docs/_ext/pictures.py``, with ``DSBRDF_REFERENCE_DATA`` set to a folder of MERL files, writes the picture in
the README, and small ones of the measured materials for the gallery of those who do not have the data.
"""

import json
import os
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.paper.materials import Material, Numbers, compute, find_materials, fit_quietly
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import read_merl
from dsbrdf.data.synthetic import synthetic_measurement
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.sphere_panels import compare_spheres, cut_out, encode_png
from dsbrdf.process_settings import core_count

README_PICTURE = Path(__file__).parents[1] / "_static" / "spheres.webp"
README_MATERIALS = ("rgl_aurora_white", "rgl_satin_purple", "rgl_acrylic_felt_pink")
_README_COLUMNS = ("measured", "fit", "specular spike", "specular lobe", "diffuse")
_README_SIZE, _README_GAP, _README_TEXT = 320, 16, 44  # pixels: of a sphere, between two, and of a line of text
REFERENCE_VARIABLE = "DSBRDF_REFERENCE_DATA"
MEASURED = Path(__file__).parents[1] / "_static" / "measured"
SIZE = 224  # pixels; shown at half of that or a little more
_STRIP = 128  # pixels of a sphere in a strip
_METRICS = ("relative_rms", "excess", "psnr")
SYNTHETIC = {
    "paint": {"roughness": 0.06, "diffuse": (0.40, 0.16, 0.10), "specular": (0.04, 0.04, 0.04)},
    "copper": {"roughness": 0.15, "diffuse": (0.0, 0.0, 0.0), "specular": (0.95, 0.64, 0.54)},
    "clay": {"roughness": 0.7, "diffuse": (0.60, 0.50, 0.40), "specular": (0.02, 0.02, 0.02)},
}
"""Arguments of `synthetic_measurement` by name; all have 2 % noise."""


@dataclass(frozen=True, eq=False)
class Exhibit:
    """A material with its fit.

    Attributes
    ----------
    name : str
    kind : str
        Where the data come from: measured, decoded stand-in or synthetic.
    panels : dict of ndarray, shape (SIZE, SIZE, 3)
        Pictures by title, as a screen shows them.
    metrics : dict of str to float
    n_lobes : int
    """

    name: str
    kind: str
    panels: dict[str, NDArray[np.float64]]
    metrics: dict[str, float]
    n_lobes: int


def synthetic_exhibits(lighting: str) -> list[Exhibit]:
    """Make, fit and draw the synthetic materials."""
    exhibits = []
    for name, arguments in SYNTHETIC.items():
        measurement = synthetic_measurement(**arguments, noise=0.02, name=name)  # type: ignore[arg-type]
        numbers = _numbers(measurement, fit_quietly(measurement, FitOptions()), lighting)
        exhibits.append(_exhibit(name, "synthetic", numbers))
    return exhibits


def reference_exhibits(folder: Path, kept: Path) -> tuple[list[Exhibit], list[str]]:
    """Fit and draw the materials of a folder, the measured ones first; also return the messages of those that failed.

    Fits and pictures are kept in the folder `kept` for the next time.
    """
    materials = sorted(find_materials(folder, kept), key=lambda material: not material.measured)
    computed, failures = compute(materials, _measure, kept, settings=f"{SIZE}", jobs=core_count())
    exhibits = [_exhibit(one.name, "measured" if one.measured else "decoded stand-in", one.numbers) for one in computed]
    return exhibits, [f"{failure.file.stem}: {failure.message}" for failure in failures]


def readme_picture(folder: Path) -> bytes:
    """Return a WebP file of materials in a folder, one in a row: measured, the fit, and the components of the fit."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    step, rows = _README_SIZE + _README_GAP, len(README_MATERIALS)
    width, height = _README_TEXT + step * len(_README_COLUMNS), _README_TEXT + step * rows
    canvas = FigureCanvasAgg(Figure(figsize=(width / 100.0, height / 100.0), dpi=100.0, facecolor="none"))
    text = {"color": "0.5", "fontsize": 22, "ha": "center", "va": "center"}  # seen on white and on black
    for row, name in enumerate(README_MATERIALS):
        measurement = read_merl(folder / f"{name}.binary")
        result = fit_quietly(measurement, FitOptions())
        panels = compare_spheres(measurement, result.model, lighting="environment", size=_README_SIZE).panels
        below = step * (rows - 1 - row)
        title = name.removeprefix("rgl_").replace("_", " ")
        canvas.figure.text(22 / width, (below + step / 2) / height, title, rotation=90, **text)
        for column, panel in enumerate(_README_COLUMNS):
            if panel in panels:
                canvas.figure.figimage(cut_out(panels[panel]), _README_TEXT + step * column, below)
    for column, panel in enumerate(_README_COLUMNS):
        place = _README_TEXT + step * (column + 0.5)
        canvas.figure.text(place / width, 1.0 - _README_TEXT / 2 / height, panel, **text)
    canvas.draw()
    file = BytesIO()
    Image.fromarray(np.asarray(canvas.buffer_rgba())).save(file, "webp", quality=90)
    return file.getvalue()


def encode(*panels: NDArray[np.float64]) -> bytes:
    """Return a PNG file of panels side by side that are transparent beside the spheres."""
    return encode_png(np.concatenate([cut_out(panel) for panel in panels], axis=1))


def _measure(material: Material) -> Numbers:
    return _numbers(material.measurement, material.fit(), "three_lights")


def _numbers(measurement: Measurement, result: FitResult, lighting: str) -> Numbers:
    """Draw a measurement and its fit as arrays that can be stored."""
    compared = compare_spheres(measurement, result.model, lighting=lighting, size=SIZE)
    metrics = [getattr(result.report.metrics, name) for name in _METRICS]
    return {
        "titles": np.array(list(compared.seen)),
        "panels": np.rint(255.0 * np.stack(list(compared.seen.values()))).astype(np.uint8),
        "metrics": np.array(metrics, dtype=np.float64),
        "n_lobes": np.array(result.model.n_lobes),
    }


def _exhibit(name: str, kind: str, numbers: Numbers) -> Exhibit:
    panels = dict(zip(numbers["titles"].tolist(), numbers["panels"] / 255.0, strict=True))
    panels = {kind if title == "measured" else title: panel for title, panel in panels.items()}
    metrics = dict(zip(_METRICS, numbers["metrics"].tolist(), strict=True))
    return Exhibit(name, kind, panels, metrics, int(numbers["n_lobes"]))


def write_measured(folder: Path, kept: Path) -> None:
    """Write a strip of spheres of each measured material of a folder, and `materials.json` with their numbers."""
    from PIL import Image

    MEASURED.mkdir(exist_ok=True)
    table = {}
    for exhibit in reference_exhibits(folder, kept)[0]:
        if exhibit.kind != "measured":
            continue  # the others have other licences
        spheres = np.concatenate([cut_out(panel) for panel in exhibit.panels.values()], axis=1)
        strip = Image.fromarray(np.rint(255.0 * spheres).astype(np.uint8))
        size = (_STRIP * len(exhibit.panels), _STRIP)
        strip.resize(size, Image.Resampling.LANCZOS).save(MEASURED / f"{exhibit.name}.webp", quality=85)
        metrics = {name: round(value, 4) for name, value in exhibit.metrics.items()}
        table[exhibit.name] = {"panels": [*exhibit.panels], "n_lobes": exhibit.n_lobes, **metrics}
    (MEASURED / "materials.json").write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    reference = Path(os.environ[REFERENCE_VARIABLE])
    README_PICTURE.write_bytes(readme_picture(reference))
    write_measured(reference, Path(__file__).parents[1] / "_build" / "materials")
