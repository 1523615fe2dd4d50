"""Where fits run: processes of this machine or of a Dask cluster."""

from dsbrdf.engines.batch import fit_files
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine, Fault, FitTask, Fitted, Limits, Outcome
from dsbrdf.engines.local import LocalEngine

__all__ = ["DaskEngine", "Engine", "Fault", "FitTask", "Fitted", "Limits", "LocalEngine", "Outcome", "fit_files"]
