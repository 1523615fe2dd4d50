"""Define the functions that `Computations.run_in_process` calls in separate processes.

Every process of a computation imports this module, so the module imports nothing of the service. The files of
measurements are checked before their paths are passed to these functions.
"""

import hashlib
import os
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.components.component import Component
from dsbrdf.components.layers import LayeredModel
from dsbrdf.data.measurement import LOG_OFFSET_PER_SR, Measurement
from dsbrdf.data.merl import encode_merl, map_merl
from dsbrdf.data.reduction import profiles
from dsbrdf.engines.engine import OnProgress
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.output.documents import summary_of_table
from dsbrdf.output.export import export_model
from dsbrdf.output.figure_panels import encode_figure
from dsbrdf.output.figures import parameters_figure, residual_figure
from dsbrdf.output.plots import samples_residual_figure
from dsbrdf.output.sphere_panels import encode_png
from dsbrdf.rendering.environment import EnvironmentMap
from dsbrdf.rendering.sphere import displayed, exposure, render_sphere, sphere_normals
from dsbrdf.samples.reading import open_checked, parse_samples, read_measurement, read_table
from dsbrdf.samples.table_options import TableOptions

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StoredMeasurement:
    """The path, the sha256 and the name of a stored measurement."""

    path: Path
    sha256: str
    name: str | None = None  # Title of figures; without a name, the title is the beginning of the sha256.

    def mapped(self) -> Measurement:
        """Return the measurement, with its file mapped into memory."""
        return map_merl(self.path, self.sha256)


Material = ReflectanceModel | StoredMeasurement


def sphere_step(
    file_format: str, whole: Material, part: Material, light: str | NDArray[np.float32], size: int, _: OnProgress
) -> bytes:
    """Return a lit sphere of a model, a `part` of a model, or a measurement; the light may be a panorama.

    The sphere is a .png with the exposure of the `whole`, or a .npy of linear RGB radiance, float32 rows from the top.
    """
    around = light if isinstance(light, str) else EnvironmentMap.from_pixels(light)

    def sphere(material: Material) -> Array:
        shown = material.mapped() if isinstance(material, StoredMeasurement) else material
        return render_sphere(shown, lighting=around, size=size)

    image = sphere(part)
    if file_format == "npy":
        return npy_bytes(image.astype("<f4"))
    factor = exposure(image if part is whole else sphere(whole), sphere_normals(size)[1])
    return encode_png(displayed(image, factor))


def measured_step(
    stored: StoredMeasurement, theta_half: Array, theta_diff: Array, phi_diff: Array, _: OnProgress
) -> Array:
    """Return a measurement's values at points (n,), shape (n, 3), computed by `Measurement.evaluate`."""
    return stored.mapped().evaluate(theta_half, theta_diff, phi_diff)


def table_step(stored: StoredMeasurement, path: Path, _: OnProgress) -> None:
    """Write a .npy of ln(value + 1e-6) of a measurement at all nodes, float16 (theta_half, theta_diff, phi_diff, RGB).

    Linear interpolation of this table equals the library's interpolation of the measurement.
    """
    measurement = stored.mapped()
    source, channels = measurement.interpolated.source, zip(measurement.stored, measurement.scale, strict=True)
    values = [np.maximum(channel.ravel()[source] * scale, 0.0) for channel, scale in channels]
    path.write_bytes(npy_bytes(np.log(np.stack(values, axis=-1) + LOG_OFFSET_PER_SR).astype("<f2")))


def npy_bytes(array: NDArray[Any]) -> bytes:
    """Return an array as the content of a .npy file."""
    file = BytesIO()
    np.save(file, array)
    return file.getvalue()


def figure_step(
    figure: str, model: DSBRDF, stored: StoredMeasurement, options: FitOptions, dark: bool, _: OnProgress
) -> bytes:
    """Return the figure `parameters` or `residual` of a fit as SVG, optionally for a dark background."""
    import matplotlib as mpl
    import matplotlib.style

    mpl.style.use("dark_background" if dark else "default")
    mpl.rcParams["savefig.transparent"] = dark  # The page shows through, because few dark pages are black.
    mpl.rcParams["svg.hashsalt"] = "dsbrdf"  # Equal figures get equal bytes, as their equal ETags promise.
    measured = replace(open_checked(stored.path, stored.sha256), name=stored.name or stored.sha256[:12])
    if figure == "parameters":
        drawn = parameters_figure(model, title=measured.name)
    elif isinstance(measured, Measurement):
        drawn = residual_figure(profiles(measured, horizon_cutoff=options.horizon_cutoff), model)
    else:
        drawn = samples_residual_figure(measured, model)
    return encode_figure(drawn, "svg")


def samples_step(stored: StoredMeasurement, max_samples: int, _: OnProgress) -> bytes:
    """Return a .npy of omega_in, omega_out and values of samples, float32 (n, 9), at most `max_samples` at random."""
    samples = parse_samples(stored.path.read_bytes())
    table = np.concatenate([samples.omega_in, samples.omega_out, samples.values], axis=1)
    if len(table) > max_samples:
        table = table[np.sort(np.random.default_rng(0).permutation(len(table))[:max_samples])]
    return npy_bytes(table.astype("<f4"))


def understood_step(content: bytes, options: TableOptions, _: OnProgress) -> dict[str, Any]:
    """Read a table and return its summary, as `dsbrdf table` prints it.

    Raises MeasurementFormatError if the table cannot be read.
    """
    return summary_of_table(read_table(content, options=options))


def export_step(
    model: DSBRDF | LayeredModel | Component, file_format: str, title: str, path: Path, _: OnProgress
) -> None:
    """Write the file that `export_model` makes, for formats that take long or have long files."""
    path.write_bytes(export_model(model, file_format, title=title))


def conversion_step(path: Path, options: TableOptions, _: OnProgress) -> tuple[str, int, int]:
    """Convert the uploaded file at `path` in place: an RGL file to a MERL table, a table to a file of samples.

    Return the sha256 and the length of the converted file, and the number of grid nodes with a value, 0 for samples.

    Raises MeasurementFormatError if the file is wrong, and InvalidArgumentError for options of a table if it is none.
    """
    measured = read_measurement(path, options)
    if isinstance(measured, Measurement):
        content, valid_nodes = encode_merl(measured), int(measured.valid.sum())
    else:
        content, valid_nodes = measured.encode(), 0
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return hashlib.sha256(content).hexdigest(), len(content), valid_nodes
