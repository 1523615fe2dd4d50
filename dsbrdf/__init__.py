"""Directional Statistics BRDF models of measured reflectance (Nishino, ICCV 2009).

    measurement = dsbrdf.read_merl("nickel.binary")
    result = dsbrdf.fit(measurement)
    result.model.evaluate(theta_half, theta_diff)
    dsbrdf.decompose(result.model).diffuse

Angles are in radians, BRDF values in 1/sr, channels in the order red, green, blue.

Wings, each calling only those to its left: arrays, errors, version, extras, process_settings, notebook_display, data,
model, rendering, fitting, paper, components, samples, report_warnings, pipeline, output, engines, cli.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from dsbrdf.notebook_display import register as _register_with_notebook

if TYPE_CHECKING:
    from dsbrdf.components.decomposition import Component as Component
    from dsbrdf.components.decomposition import Decomposition as Decomposition
    from dsbrdf.components.decomposition import decompose as decompose
    from dsbrdf.data.measurement import Measurement as Measurement
    from dsbrdf.data.merl import parse_merl as parse_merl
    from dsbrdf.data.merl import read_merl as read_merl
    from dsbrdf.data.merl import write_merl as write_merl
    from dsbrdf.data.reduction import Profiles as Profiles
    from dsbrdf.data.reduction import profiles as profiles
    from dsbrdf.errors import ConvergenceWarning as ConvergenceWarning
    from dsbrdf.errors import DSBRDFError as DSBRDFError
    from dsbrdf.errors import FitError as FitError
    from dsbrdf.errors import ImageFormatError as ImageFormatError
    from dsbrdf.errors import InvalidArgumentError as InvalidArgumentError
    from dsbrdf.errors import MeasurementFormatError as MeasurementFormatError
    from dsbrdf.errors import ModelFormatError as ModelFormatError
    from dsbrdf.fitting.options import FitOptions as FitOptions
    from dsbrdf.fitting.report import FitReport as FitReport
    from dsbrdf.fitting.report import FitResult as FitResult
    from dsbrdf.model.blend import Blend as Blend
    from dsbrdf.model.blend import blend as blend
    from dsbrdf.model.dsbrdf import DSBRDF as DSBRDF
    from dsbrdf.model.furnace import FurnaceReport as FurnaceReport
    from dsbrdf.model.furnace import white_furnace as white_furnace
    from dsbrdf.output.export import export as export
    from dsbrdf.output.plots import plot as plot
    from dsbrdf.output.serialize import load as load
    from dsbrdf.output.serialize import save as save
    from dsbrdf.pipeline import fit as fit
    from dsbrdf.rendering.environment import EnvironmentMap as EnvironmentMap
    from dsbrdf.rendering.environment import read_environment as read_environment
    from dsbrdf.rendering.space import MaterialSpace as MaterialSpace
    from dsbrdf.rendering.space import space as space
    from dsbrdf.rendering.sphere import render_sphere as render_sphere
    from dsbrdf.samples.measurement_files import read_measurement as read_measurement
    from dsbrdf.samples.reading import read_samples as read_samples
    from dsbrdf.samples.scattered_samples import ScatteredSamples as ScatteredSamples
    from dsbrdf.samples.table_options import TableOptions as TableOptions
    from dsbrdf.version import ALGORITHM_VERSION as ALGORITHM_VERSION
    from dsbrdf.version import __version__ as __version__

# Where each public name is defined. A name is imported when it is first used, so that `import dsbrdf` and the
# commands that compute nothing do not wait for NumPy and SciPy.
_DEFINED_IN = {
    "data.measurement": "Measurement",
    "samples.measurement_files": "read_measurement",
    "data.merl": "parse_merl read_merl write_merl",
    "data.reduction": "Profiles profiles",
    "samples.reading": "read_samples",
    "samples.scattered_samples": "ScatteredSamples",
    "samples.table_options": "TableOptions",
    "errors": "ConvergenceWarning DSBRDFError FitError ImageFormatError InvalidArgumentError MeasurementFormatError "
    "ModelFormatError",
    "fitting.options": "FitOptions",
    "pipeline": "fit",
    "fitting.report": "FitReport FitResult",
    "components.decomposition": "Component Decomposition decompose",
    "model.blend": "Blend blend",
    "model.dsbrdf": "DSBRDF",
    "rendering.environment": "EnvironmentMap read_environment",
    "model.furnace": "FurnaceReport white_furnace",
    "rendering.space": "MaterialSpace space",
    "rendering.sphere": "render_sphere",
    "output.export": "export",
    "output.plots": "plot",
    "output.serialize": "load save",
    "version": "ALGORITHM_VERSION __version__",
}
_MODULE_OF = {name: f"dsbrdf.{module}" for module, names in _DEFINED_IN.items() for name in names.split()}
__all__ = sorted(_MODULE_OF)


if not TYPE_CHECKING:  # a type checker would take every name for granted

    def __getattr__(name: str) -> object:
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(_MODULE_OF[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return __all__


_register_with_notebook()
