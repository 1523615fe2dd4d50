"""Where fits run: in this process, in processes of this machine, or on a Dask cluster."""

from dsbrdf.engines.batch import fit_files
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine, Fault, FitLimits, FitTask, Outcome
from dsbrdf.engines.local import LocalEngine

__all__ = ["DaskEngine", "Engine", "Fault", "FitLimits", "FitTask", "LocalEngine", "Outcome", "fit_files"]
