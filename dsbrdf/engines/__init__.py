"""Run fits: in this process, in processes of this machine, or on a Dask cluster."""

from dsbrdf.engines.batch import FileFit, fit_files
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine, Fault, FitDocument, FitLimits, FitTask, OnProgress, Outcome
from dsbrdf.engines.local import LocalEngine, Processes

__all__ = [
    "DaskEngine",
    "Engine",
    "Fault",
    "FileFit",
    "FitDocument",
    "FitLimits",
    "FitTask",
    "LocalEngine",
    "OnProgress",
    "Outcome",
    "Processes",
    "fit_files",
]
