"""What a fit can be turned into: documents, tables, pictures and files of other programs."""

from dsbrdf.output.export import FORMATS, export_model
from dsbrdf.output.serialize import load, save

__all__ = ["FORMATS", "export_model", "load", "save"]
