"""Fit the lobes of a model to profiles: options, the default fit, metrics and the report."""

from dsbrdf.fitting.metrics import METRICS, OUTSIDE_CENTER, Metrics, relative_errors, sample_errors
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import DirectionalAlbedo, KnotReport, SelectionStep

__all__ = [
    "METRICS",
    "OUTSIDE_CENTER",
    "DirectionalAlbedo",
    "FitOptions",
    "KnotReport",
    "Metrics",
    "SelectionStep",
    "relative_errors",
    "sample_errors",
]
