"""From profiles to a model and a report."""

from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitReport, FitResult

__all__ = ["FitOptions", "FitReport", "FitResult", "fit"]
