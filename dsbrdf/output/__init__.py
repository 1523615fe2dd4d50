"""Write results of a fit for people and programs: stored models, text, figures and exported files."""

from dsbrdf.output.export import FORMATS, export_model
from dsbrdf.output.figure_panels import encode_figure
from dsbrdf.output.plots import plot
from dsbrdf.output.serialize import fit_from_json, from_json, load, result_from_json, save, to_json

__all__ = [
    "FORMATS",
    "encode_figure",
    "export_model",
    "fit_from_json",
    "from_json",
    "load",
    "plot",
    "result_from_json",
    "save",
    "to_json",
]
