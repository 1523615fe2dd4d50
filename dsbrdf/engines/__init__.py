"""Run fits: in this process, in processes of this machine, or on a Dask cluster."""

from dsbrdf.engines.batch import FileFit as FileFit
from dsbrdf.engines.batch import fit_files as fit_files
from dsbrdf.engines.dask import DaskEngine as DaskEngine
from dsbrdf.engines.engine import Engine as Engine
from dsbrdf.engines.engine import Fault as Fault
from dsbrdf.engines.engine import FitDocument as FitDocument
from dsbrdf.engines.engine import FitLimits as FitLimits
from dsbrdf.engines.engine import FitTask as FitTask
from dsbrdf.engines.engine import OnProgress as OnProgress
from dsbrdf.engines.engine import Outcome as Outcome
from dsbrdf.engines.local import LocalEngine as LocalEngine
from dsbrdf.engines.local import Processes as Processes
