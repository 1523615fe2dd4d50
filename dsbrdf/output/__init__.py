"""Write results of a fit for people and programs: stored models, text, figures and exported files."""

from dsbrdf.output.export import FORMATS as FORMATS
from dsbrdf.output.export import export_model as export_model
from dsbrdf.output.figure_panels import encode_figure as encode_figure
from dsbrdf.output.plots import plot as plot
from dsbrdf.output.serialize import fit_from_json as fit_from_json
from dsbrdf.output.serialize import from_json as from_json
from dsbrdf.output.serialize import load as load
from dsbrdf.output.serialize import result_from_json as result_from_json
from dsbrdf.output.serialize import save as save
from dsbrdf.output.serialize import to_json as to_json
