"""Results of a fit for people and other programs: stored models, text, figures, exported files."""

from dsbrdf.output.export import FORMATS, export_model
from dsbrdf.output.serialize import load, load_result, save

__all__ = ["FORMATS", "export_model", "load", "load_result", "save"]
