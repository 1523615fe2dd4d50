"""From profiles to a model and a report, and from a model to its components."""

from dsbrdf.fitting.decomposition import Component, Decomposition, decompose
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitReport, FitResult

__all__ = ["Component", "Decomposition", "FitOptions", "FitReport", "FitResult", "decompose", "fit"]
