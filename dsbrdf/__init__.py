"""Directional Statistics BRDF models of measured reflectance (Nishino, ICCV 2009).

    measurement = dsbrdf.read_merl("nickel.binary")
    result = dsbrdf.fit(measurement)
    result.model.evaluate(theta_half, theta_diff)
    dsbrdf.decompose(result.model).diffuse

Angles are in radians, BRDF values in 1/sr, channels in the order red, green, blue.

Wings, each calling only those to its left: errors, version, extras, process_settings, data, model, fitting, output,
engines, cli.  One exception: the methods `plot` and `_repr_html_` call `dsbrdf.output.notebook`, and `export`
`dsbrdf.output.export.export_file`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dsbrdf.data.measurement import Measurement
    from dsbrdf.data.measurement_files import read_measurement
    from dsbrdf.data.merl import parse_merl, read_merl, write_merl
    from dsbrdf.data.reduction import Profiles, profiles
    from dsbrdf.data.scattered_samples import ScatteredSamples
    from dsbrdf.errors import (
        ConvergenceWarning,
        DSBRDFError,
        FitError,
        ImageFormatError,
        InvalidArgumentError,
        MeasurementFormatError,
        ModelFormatError,
    )
    from dsbrdf.fitting.decomposition import Component, Decomposition, decompose
    from dsbrdf.fitting.options import FitOptions
    from dsbrdf.fitting.pipeline import fit
    from dsbrdf.fitting.report import FitReport, FitResult
    from dsbrdf.model.dsbrdf import DSBRDF
    from dsbrdf.model.environment import EnvironmentMap, read_environment
    from dsbrdf.model.furnace import FurnaceReport, white_furnace
    from dsbrdf.model.render import render_sphere
    from dsbrdf.output.export.export_file import export
    from dsbrdf.output.serialize import load, load_result, save
    from dsbrdf.version import ALGORITHM_VERSION, __version__

__all__ = [
    "ALGORITHM_VERSION",
    "DSBRDF",
    "Component",
    "ConvergenceWarning",
    "DSBRDFError",
    "Decomposition",
    "EnvironmentMap",
    "FitError",
    "FitOptions",
    "FitReport",
    "FitResult",
    "FurnaceReport",
    "ImageFormatError",
    "InvalidArgumentError",
    "Measurement",
    "MeasurementFormatError",
    "ModelFormatError",
    "Profiles",
    "ScatteredSamples",
    "__version__",
    "decompose",
    "export",
    "fit",
    "load",
    "load_result",
    "parse_merl",
    "profiles",
    "read_environment",
    "read_measurement",
    "read_merl",
    "render_sphere",
    "save",
    "white_furnace",
    "write_merl",
]

# Where each public name is defined. A name is imported when it is first used, so that `import dsbrdf` and the
# commands that compute nothing do not wait for NumPy and SciPy.
_DEFINED_IN = {
    "dsbrdf.data.measurement": ("Measurement",),
    "dsbrdf.data.measurement_files": ("read_measurement",),
    "dsbrdf.data.merl": ("parse_merl", "read_merl", "write_merl"),
    "dsbrdf.data.reduction": ("Profiles", "profiles"),
    "dsbrdf.data.scattered_samples": ("ScatteredSamples",),
    "dsbrdf.errors": (
        "ConvergenceWarning",
        "DSBRDFError",
        "FitError",
        "ImageFormatError",
        "InvalidArgumentError",
        "MeasurementFormatError",
        "ModelFormatError",
    ),
    "dsbrdf.fitting.options": ("FitOptions",),
    "dsbrdf.fitting.pipeline": ("fit",),
    "dsbrdf.fitting.report": ("FitReport", "FitResult"),
    "dsbrdf.fitting.decomposition": ("Component", "Decomposition", "decompose"),
    "dsbrdf.model.dsbrdf": ("DSBRDF",),
    "dsbrdf.model.environment": ("EnvironmentMap", "read_environment"),
    "dsbrdf.model.furnace": ("FurnaceReport", "white_furnace"),
    "dsbrdf.model.render": ("render_sphere",),
    "dsbrdf.output.export.export_file": ("export",),
    "dsbrdf.output.serialize": ("load", "load_result", "save"),
    "dsbrdf.version": ("ALGORITHM_VERSION", "__version__"),
}
_MODULE_OF = {name: module for module, names in _DEFINED_IN.items() for name in names}


if not TYPE_CHECKING:  # a type checker would take every name for granted

    def __getattr__(name: str) -> object:
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(_MODULE_OF[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
