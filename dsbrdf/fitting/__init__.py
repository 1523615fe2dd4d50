"""Fit the lobes of a model to profiles: options, the default fit, metrics and the report."""

from dsbrdf.fitting.metrics import METRICS as METRICS
from dsbrdf.fitting.metrics import OUTSIDE_CENTER as OUTSIDE_CENTER
from dsbrdf.fitting.metrics import Metrics as Metrics
from dsbrdf.fitting.metrics import relative_errors as relative_errors
from dsbrdf.fitting.metrics import sample_errors as sample_errors
from dsbrdf.fitting.options import FitOptions as FitOptions
from dsbrdf.fitting.report import DirectionalAlbedo as DirectionalAlbedo
from dsbrdf.fitting.report import KnotReport as KnotReport
from dsbrdf.fitting.report import SelectionStep as SelectionStep
